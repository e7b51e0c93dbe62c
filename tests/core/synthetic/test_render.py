"""Pictures and truth of the synthetic scene agree with each other, between cameras and between frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.arrays import Bool, Float64
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.initialise.views import pixel_centres, project, unproject
from streamlod.core.synthetic import (
    GroundTruth,
    SyntheticSpec,
    cameras,
    ground_truth,
    render_image,
    surface_motion,
)
from streamlod.core.synthetic import render as inside
from streamlod.core.synthetic.kinds import KINDS

SPEC = SyntheticSpec(cameras=5, frames=60, width=160, height=90, noise=0.0)


def world(truth: GroundTruth, camera: Camera) -> Float64:
    """[H*W,3] the surface points that a picture shows."""
    return unproject(camera, pixel_centres(camera), truth.depth.astype(np.float64).ravel())


def look_up(camera: Camera, points: Float64) -> tuple[Bool, tuple[np.ndarray, np.ndarray], Float64]:
    """Which points a camera's picture covers, the pixels they fall on, and their depth."""
    pixels, depth = project(camera, points)
    fits = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1)
    column, row = np.where(fits[:, None], pixels, 0).astype(int).T
    return fits, (row, column), depth


def test_equal_specs_give_equal_pictures_and_another_seed_gives_others() -> None:
    noisy = replace(SPEC, width=80, height=45, noise=2.0)
    again = replace(noisy)
    assert np.array_equal(render_image(noisy, 7, 1), render_image(again, 7, 1))
    assert not np.array_equal(render_image(noisy, 7, 1), render_image(replace(noisy, seed=1), 7, 1))
    assert not np.array_equal(render_image(noisy, 7, 1), render_image(noisy, 8, 1))


@pytest.mark.parametrize(("kind", "index"), [("room", 0), ("room", 17), ("room", 44), *((kind, 17) for kind in KINDS)])
def test_reusing_the_empty_room_changes_nothing(kind: str, index: int) -> None:
    spec = replace(SPEC, kind=kind)
    camera = cameras(spec)[3]
    full = inside._colour(spec.place, inside.scene_at(spec, index), camera, np.arange(spec.width * spec.height))
    expected = inside.develop(full.reshape(spec.height, spec.width, 3), spec, index, 3)
    difference = np.abs(expected.astype(int) - render_image(spec, index, 3))
    assert difference.max() <= 1  # the empty room is kept in float32
    assert (difference > 0).mean() < 1e-3


def test_depth_agrees_between_cameras_and_so_do_colours() -> None:
    first, second = (ground_truth(SPEC, 20, camera) for camera in (0, 2))
    points = world(first, cameras(SPEC)[0])
    fits, pixels, depth = look_up(cameras(SPEC)[2], points)
    there = second.depth[pixels]
    same = fits & (np.abs(there / depth - 1) < 0.02)
    assert same[fits].mean() > 0.75
    hidden = fits & (depth < there * 0.9)  # a point before everything that the other camera sees there
    assert hidden[fits].mean() < 0.02  # only at the edges of things
    matt = same & ~first.mirror.ravel() & ~second.mirror[pixels]
    seen, other = (render_image(SPEC, 20, camera) for camera in (0, 2))
    error = np.abs(seen.reshape(-1, 3)[matt].astype(int) - other[pixels][matt])
    assert np.median(error) < 10


def test_motion_leads_back_to_the_frame_before() -> None:
    camera = cameras(SPEC)[0]
    now, before = ground_truth(SPEC, 31, 0), ground_truth(SPEC, 30, 0)
    origin = world(now, camera) - now.motion.reshape(-1, 3)
    fits, pixels, depth = look_up(camera, origin)
    on_mover = fits & now.moving.ravel()
    assert on_mover.sum() > 200
    on_surface = np.abs(before.depth[pixels] / depth - 1) < 0.02
    assert on_surface[on_mover].mean() > 0.9
    assert np.linalg.norm(now.motion, axis=2).max() < 0.2  # metres a frame


def test_a_still_clip_does_not_move() -> None:
    still = replace(SPEC, still=True)
    truth = ground_truth(still, 40, 1)
    assert not truth.moving.any()
    assert not truth.motion.any()
    assert np.array_equal(render_image(still, 40, 1), render_image(still, 0, 1))


def test_nothing_moves_in_the_step_to_the_first_frame() -> None:
    truth = ground_truth(SPEC, 0, 0)
    assert not truth.moving.any()


@pytest.mark.parametrize("frames", [20, 60])
def test_the_visitor_appears_and_leaves(frames: int) -> None:
    spec = replace(SPEC, frames=frames)
    camera = cameras(spec)[0]
    head = np.array([[-0.42, 3.85, 1.05]])
    _, pixels, depth = look_up(camera, head)
    depths = [float(ground_truth(spec, index, 0).depth[pixels][0]) for index in (0, frames // 2, frames - 1)]
    assert depths[1] < depths[0] - 0.1
    assert depths[1] == pytest.approx(float(depth[0]), abs=0.15)
    assert depths[2] == pytest.approx(depths[0], abs=1e-4)


def test_mirrors_change_although_they_do_not_move() -> None:
    first, later = ground_truth(SPEC, 10, 1), ground_truth(SPEC, 25, 1)
    shiny = first.mirror & later.mirror & ~later.moving
    assert shiny.mean() > 0.005
    pictures = [render_image(SPEC, index, 1)[shiny].astype(int) for index in (10, 25)]
    assert np.abs(pictures[0] - pictures[1]).max() > 25


def test_noise_and_exposure_are_as_asked() -> None:
    spec = replace(SPEC, width=80, height=45)
    clean = render_image(spec, 3, 2).astype(float)
    noisy = render_image(replace(spec, noise=4.0), 3, 2).astype(float)
    middling = (clean > 40) & (clean < 215)
    assert (noisy - clean)[middling].std() == pytest.approx(4.0, rel=0.05)
    spread = replace(spec, exposure_spread=0.5)
    assert np.array_equal(render_image(spread, 3, 0), render_image(spec, 3, 0))
    ratios = [render_image(spread, 3, c).mean() / render_image(spec, 3, c).mean() for c in range(1, 5)]
    assert max(ratios) / min(ratios) > 1.1


def test_the_rig_looks_forward_with_its_first_camera_in_the_middle() -> None:
    rig = cameras(SyntheticSpec(cameras=13))
    assert [camera.name for camera in rig[:3]] == ["cam00", "cam01", "cam02"]
    across = np.array([camera.centre[0] for camera in rig])
    assert (np.diff(across[1:]) > 0).all()
    assert across[0] == pytest.approx(0.0, abs=1e-9)
    assert all(camera.world_to_camera[2, 1] > 0.8 for camera in rig)


@pytest.mark.parametrize(
    "fields", [{"cameras": 0}, {"frames": 0}, {"width": 8}, {"noise": -1.0}, {"noise": float("nan")}, {"fps": 0.0}]
)
def test_a_spec_refuses_what_it_cannot_mean(fields: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(fields))):
        replace(SPEC, **fields)  # type: ignore[arg-type]


def test_frames_and_cameras_outside_the_clip_are_refused() -> None:
    for index, camera in ((60, 0), (-1, 0), (0, 5)):
        with pytest.raises(ValueError, match="outside"):
            ground_truth(SPEC, index, camera)


def test_motion_in_pixels_leads_to_the_same_surface() -> None:
    """Where a surface was seen, and how far it went, agree with the motion that the next frame's truth tells."""
    camera = cameras(SPEC)[0]
    now = ground_truth(SPEC, 31, 0)
    ahead = surface_motion(SPEC, 31, camera)
    both = now.moving & (ahead > 0)  # most of a mover stays in the picture from one frame to the next
    assert both.sum() > 0.8 * now.moving.sum()
    behind = np.linalg.norm(now.motion, axis=2) * camera.intrinsics[0, 0] / now.depth  # in pixels, were it all sideways
    assert np.median(ahead[both]) == pytest.approx(np.median(behind[both]), rel=0.5)
    assert (ahead[~now.moving] > 0).mean() < 0.02
    assert not surface_motion(replace(SPEC, still=True), 31, camera).any()
    assert not surface_motion(SPEC, 0, camera).any()
