"""Space before the scene: which anchors cannot be right, and that the first frame's training removes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.methods.combined import merged
from streamlod.core.initialise.views import inside, project, unproject
from streamlod.core.scene.expand import anchor_positions
from streamlod.core.scene.octree import Octree
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.near_space import near_space
from streamlod.core.train.keyframe.seeding import seed_field
from tests.core.true_points import true_points


def camera(x: float) -> Camera:
    """At (x, 0, 0), looking along y."""
    eye = np.array([x, 0.0, 0.0])
    pose = look_at(eye, eye + np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    return pinhole(f"{x}", (40, 40), (32, 24), (64, 48), pose)


def field_at(*positions: tuple[float, float, float]) -> Field:
    """Anchors whose two Gaussians lie on them."""
    clip = open_synthetic(SyntheticSpec(cameras=2, frames=1, width=64, height=48))
    cloud = PointCloud(np.array(positions, np.float32), np.full((len(positions), 3), 0.5, np.float32))
    generator = torch.Generator().manual_seed(0)
    padded = PointCloud(np.tile(cloud.positions, (4, 1)), np.tile(cloud.colours, (4, 1)))
    field = seed_field(padded, clip.cameras, preset("live").model, generator)
    count = len(positions)
    rows = field.with_rows(torch.arange(count))
    return replace(
        rows,
        octree=Octree(np.zeros(3), 1.0, 1),
        position=torch.tensor(positions),
        offset=torch.zeros(count, field.slots, 3),
    )


CAMERAS = (camera(-0.5), camera(0.5))
WALL = PointCloud(
    np.array([(x, 4.0, z) for x in np.linspace(-2, 2, 21) for z in np.linspace(-1, 1, 11)], np.float32),
    np.ones((231, 3), np.float32),
)


@pytest.mark.parametrize(
    ("position", "wrong"),
    [
        ((0.0, 4.0, 0.0), False),
        ((0.0, 3.0, 0.0), False),  # before the wall, but no nearer than things may stand
        ((0.0, 9.0, 0.0), False),
        ((0.0, 1.0, 0.0), True),
        ((0.5, 0.1, 0.0), True),  # only one camera sees it
        ((0.0, -3.0, 0.0), True),  # behind both cameras
    ],
)
def test_anchors_near_a_camera_or_unseen_are_astray(position: tuple[float, float, float], wrong: bool) -> None:
    space = near_space(WALL, CAMERAS)
    field = field_at((0.3, 4.0, 0.2), position, (-0.3, 4.0, 0.1), (0.1, 4.0, 0.4))
    assert space.astray(field, 0.6).tolist() == [False, wrong, False, False]


def test_a_camera_that_sees_no_first_point_forbids_nothing() -> None:
    away = replace(WALL, positions=WALL.positions * np.float32([1, -1, 1]))
    space = near_space(away, CAMERAS)
    assert set(space.nearest) == {0.0}
    field = field_at((0.5, 0.5, 0.0), (0.0, 4.0, 0.0), (0.2, 4.0, 0.0), (0.4, 4.0, 0.0))
    assert not space.astray(field, 0.6).any()


def test_one_wrong_point_does_not_tell_where_the_scene_begins() -> None:
    speck = np.array([[0.0, 0.3, 0.0]], np.float32)
    wrong = PointCloud(np.concatenate([WALL.positions, speck]), np.ones((232, 3), np.float32))
    assert near_space(wrong, CAMERAS).nearest == near_space(WALL, CAMERAS).nearest


@pytest.mark.parametrize("clearance", [0.0, 0.6])
def test_training_removes_what_hangs_before_a_lens(clearance: float) -> None:
    spec = SyntheticSpec(cameras=3, frames=1, width=48, height=28, seed=1)
    clip = open_synthetic(spec)
    (frame,) = clip.frames()
    points = true_points(spec)
    nearest = near_space(points, clip.cameras).nearest[0]
    lens = clip.cameras[0]
    middle = unproject(lens, np.array([[24.0, 14.0], [25.0, 15.0]]), np.full(2, 0.3 * nearest))
    wrong = PointCloud(middle.astype(np.float32), np.ones((2, 3), np.float32))
    config = preset("live")
    short = {"steps": 20, "growth_interval": 5, "growth_from": 0.1, "effect_share": 0.0, "prune_opacity": 0.0}
    keyframe = replace(config.keyframe, clearance=clearance, **short)
    config = replace(config, keyframe=keyframe, model=replace(config.model, cell_pixels=4.0, finer_levels=1))
    scene = Trainer(clip.cameras, config, clip.fps, "cpu").keyframe(frame, merged(points, wrong)).scene
    anchors = np.concatenate([anchor_positions(scene.header, number, one) for number, one in enumerate(scene.levels)])
    pixels, depth = project(lens, anchors.astype(np.float64))
    hanging = inside(lens, pixels, depth) & (depth < 0.4 * nearest)
    assert hanging.any() == (clearance == 0)
