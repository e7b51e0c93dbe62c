"""Every kind of place is closed, exactly measured and steady; what sets each apart is there."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.errors import InputError
from streamlod.core.initialise.views import pixel_centres, project, unproject
from streamlod.core.synthetic import SyntheticSpec, cameras, ground_truth, open_synthetic, render_image, surface_motion
from streamlod.core.synthetic.kinds import KINDS
from streamlod.core.synthetic.render import scene_at


def small(kind: str, **changed: float) -> SyntheticSpec:
    return SyntheticSpec(kind=kind, cameras=5, frames=20, width=160, height=90, noise=0.0, **changed)  # type: ignore[arg-type]


def contrast(kind: str) -> float:
    """Share of pixels whose brightness differs from a neighbour's by more than a tenth of its own."""
    grey: Float64 = render_image(small(kind), 0, 0).astype(np.float64).mean(axis=2)
    across = np.abs(np.diff(grey, axis=1)) / np.maximum(grey[:, 1:], 8.0)
    return float((across > 0.1).mean())


def test_the_kinds_are_known_by_name() -> None:
    assert set(KINDS) >= {"room", "bright", "night", "theatre", "outdoor"}
    with pytest.raises(InputError, match="kind must be one of bright"):
        SyntheticSpec(kind="cellar")


@pytest.mark.parametrize("kind", KINDS)
def test_depth_of_one_camera_is_where_another_sees_the_surface(kind: str) -> None:
    spec = small(kind)
    rig = cameras(spec)
    first, second = ground_truth(spec, 5, 0), ground_truth(spec, 5, 2)
    solid = np.isfinite(first.depth.ravel())
    points = unproject(rig[0], pixel_centres(rig[0])[solid], first.depth.astype(np.float64).ravel()[solid])
    pixels, depth = project(rig[2], points)
    fits = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < (spec.width, spec.height)).all(axis=1)
    column, row = pixels[fits].astype(int).T
    there = second.depth[row, column]
    assert (np.abs(there / depth[fits] - 1) < 0.02).mean() > 0.6
    assert (depth[fits] < 0.9 * there).mean() < 0.05  # before everything that the other camera sees there


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_cameras_stand_in_free_space_and_bounds_hold_the_depths(kind: str) -> None:
    spec = small(kind)
    near, far = open_synthetic(spec).depth_bounds or (0.0, 0.0)
    for camera in range(spec.cameras):
        truth = ground_truth(spec, 0, camera)
        solid = truth.depth[np.isfinite(truth.depth)]
        assert 0.5 < near < solid.min()
        assert solid.max() < far < 200
        assert render_image(spec, 0, camera).std() > 15  # nobody looks at the inside of a thing


@pytest.mark.parametrize("kind", KINDS)
def test_things_move_and_only_they(kind: str) -> None:
    spec = small(kind)
    truth = ground_truth(spec, 6, 0)
    assert 0.005 < truth.moving.mean() < 0.5
    assert len(scene_at(spec, 0).material) == len(scene_at(spec, 19).material)
    assert not surface_motion(spec, 6, cameras(spec)[0])[~truth.moving].max() > 30
    assert np.array_equal(render_image(spec, 3, 1), render_image(spec, 3, 1))


def test_only_the_outdoor_place_has_a_sky_and_it_is_infinitely_far() -> None:
    for kind in KINDS:
        depth = ground_truth(small(kind), 0, 0).depth
        assert np.isinf(depth).any() == (kind == "outdoor")
    rig = cameras(small("outdoor"))
    depth = ground_truth(small("outdoor"), 0, 0).depth
    assert 0.1 < np.isinf(depth).mean() < 0.5
    assert depth[np.isfinite(depth)].max() > 50
    assert depth.min() < 4.5
    assert np.linalg.norm(rig[1].centre - rig[2].centre) > 1.0


def test_the_bright_room_is_plain_and_the_stage_and_the_night_are_dark() -> None:
    assert contrast("bright") < 0.5 * contrast("room")
    brightness = {kind: render_image(small(kind), 0, 0).mean() for kind in KINDS}
    assert brightness["bright"] > 130
    assert brightness["theatre"] < brightness["night"] < 60
    stage = render_image(small("theatre"), 0, 0)
    assert stage.max() > 180  # the performer stands in a spot light


def test_speed_is_in_pixels_a_frame() -> None:
    for speed in (1.0, 4.0):
        spec = small("room", speed=speed)
        moved = [surface_motion(spec, index, cameras(spec)[0]).max() for index in (1, 2, 3)]
        assert 0.5 * speed < max(moved) < 8 * speed
