"""What hangs before views between cameras: its share of their pictures, and that training makes it clear away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise.methods.combined import merged
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, render_view
from streamlod.core.train import Trainer, preset
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.growth.near_space import near_space, scene_begins
from tests.core.true_points import true_points

FOCAL, WIDTH, HEIGHT = 40.0, 64, 48


def camera(x: float) -> Camera:
    """At (x, 0, 0), looking at the middle of the wall."""
    pose = look_at(np.array([x, 0.0, 0.0]), np.array([0.0, 4.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    return pinhole(f"{x}", (FOCAL, FOCAL), (WIDTH / 2, HEIGHT / 2), (WIDTH, HEIGHT), pose)


CAMERAS = (camera(-3.0), camera(3.0))
WALL = PointCloud(
    np.array([(x, 4.0, z) for x in np.linspace(-2, 2, 21) for z in np.linspace(-1, 1, 11)], np.float32),
    np.ones((231, 3), np.float32),
)


def splats(*means: tuple[float, float, float], scale: float = 0.05) -> Splats:
    """Balls of one standard deviation `scale`."""
    count = len(means)
    turn = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4)
    return Splats(torch.tensor(means), turn, torch.full((count, 3), scale), torch.ones(count), torch.zeros(count, 3))


def test_what_hangs_before_the_half_way_view_hides_its_ellipse_of_the_picture() -> None:
    hidden = near_space(WALL, CAMERAS).hidden(splats((0.0, 1.0, 0.0)), 0.6)
    assert hidden.item() == pytest.approx(np.pi * (0.05 * FOCAL / 1.0) ** 2 / (WIDTH * HEIGHT), rel=1e-5)


def test_a_flat_one_hides_by_its_two_longer_sides_and_none_more_than_the_picture() -> None:
    flat = replace(splats((0.0, 1.0, 0.0)), scales=torch.tensor([[0.001, 0.1, 0.05]]))
    round_one = splats((0.0, 1.0, 0.0))
    space = near_space(WALL, CAMERAS)
    assert space.hidden(flat, 0.6).item() == pytest.approx(2 * space.hidden(round_one, 0.6).item(), rel=1e-5)
    assert space.hidden(splats((0.0, 1.0, 0.0), scale=50.0), 0.6).item() == 1.0


@pytest.mark.parametrize(
    ("mean", "scale", "hides"),
    [
        ((0.0, 4.0, 0.0), 0.05, False),  # of the wall
        ((0.0, 2.6, 0.0), 0.05, False),  # before it, but no nearer than things may stand
        ((0.0, -1.0, 0.0), 0.05, False),  # behind who stands there
        ((1.0, 1.0, 0.0), 0.3, True),  # 8 pixels beside the picture, and 12 wide
        ((1.0, 1.0, 0.0), 0.1, False),  # 4 wide
        ((2.0, 1.0, 0.0), 1.5, False),  # so far aside that nobody draws it
    ],
)
def test_only_what_reaches_into_a_picture_before_the_scene_hides(
    mean: tuple[float, float, float], scale: float, hides: bool
) -> None:
    half_way = near_space(WALL, CAMERAS)
    half_way = replace(half_way, between=half_way.between[-1:], begins=half_way.begins[-1:])
    assert (half_way.hidden(splats(mean, scale=scale), 0.6).item() > 0) == hides


def test_where_no_first_point_is_seen_nothing_hides() -> None:
    away = replace(WALL, positions=WALL.positions * np.float32([1, -1, 1]))
    space = near_space(away, CAMERAS)
    assert set(space.begins) == {0.0}
    assert not space.hidden(splats((0.0, 1.0, 0.0), (0.0, 0.1, 0.0)), 0.6).any()


def test_one_wrong_point_of_a_hundred_does_not_tell_where_the_scene_begins() -> None:
    wrong = np.concatenate([WALL.positions, np.float32([[0.0, 0.3, 0.0], [0.1, 0.4, 0.0]])]).astype(np.float64)
    view = near_space(WALL, CAMERAS).between[-1]
    assert scene_begins(wrong, view, 0.02) == pytest.approx(scene_begins(WALL.positions.astype(np.float64), view, 0.02))


def test_training_clears_the_way_of_who_goes_from_camera_to_camera() -> None:
    """A board that one camera alone has in its picture, far from it, hangs before the view half way of two others."""
    spec = SyntheticSpec(cameras=3, frames=1, width=96, height=56, seed=1)
    target = np.array(spec.place.rig.target)
    cameras = []
    for angle in np.radians([-75.0, -25.0, 75.0]):
        eye = target + 2.5 * np.array([np.sin(angle), -np.cos(angle), 0.1])
        pose = look_at(eye, target, np.array([0.0, 0.0, 1.0]))
        cameras.append(pinhole(f"{angle:.1f}", (58, 58), (48, 28), (96, 56), pose))
    pictures = np.stack([render_view(spec, 0, one) for one in cameras])
    frame = FrameSet(0, 0, pictures, np.ones(3, np.bool_))
    points = true_points(spec)
    space = near_space(points, tuple(cameras))
    view = space.between[-1]
    ahead = view.centre + 0.3 * view.world_to_camera[2, :3]
    rng = np.random.default_rng(0)
    board = PointCloud((ahead + rng.uniform(-0.1, 0.1, (30, 3))).astype(np.float32), np.ones((30, 3), np.float32))

    def hidden(weight: float) -> float:
        config = preset("live")
        keyframe = replace(config.keyframe, steps=60, growth_from=0.65, hiding_weight=weight)
        trainer = Trainer(tuple(cameras), replace(config, keyframe=keyframe), spec.fps, "cpu")
        cloud = expand(trainer.keyframe(frame, merged(points, board)).scene, view.centre)
        parts = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
        drawn = Splats(*(torch.from_numpy(part) for part in parts))
        return float((space.hidden(drawn, config.keyframe.clearance) * drawn.opacities.clamp(min=0)).sum())

    without, priced = hidden(0.0), hidden(0.01)
    assert without > 0.02
    assert priced < 0.5 * without
