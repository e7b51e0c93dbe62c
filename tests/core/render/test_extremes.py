"""What extreme inputs give: always finite pictures and gradients, and what docs/numerics.md says of each."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from streamlod.core.camera import Camera, pinhole
from streamlod.core.errors import ModelError
from streamlod.core.render.cpu import render
from streamlod.core.scene.gaussians import GaussianCloud, concatenate
from tests.core.render.scenes import BACKGROUND, NAMES, Outcome, make_camera, make_cloud, relative, run

CAMERA = make_camera()
COUNT, ODD = 60, slice(0, 12)  # Gaussians of the scene, and those made extreme
SHAPES: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quaternions": (4,),
    "scales": (3,),
    "opacities": (),
    "colours": (3,),
}


def odd(name: str, value: float) -> GaussianCloud:
    """The scene with one parameter of some Gaussians set to `value`."""
    cloud = make_cloud(COUNT)
    array = getattr(cloud, name).copy()
    array[ODD] = value
    return replace(cloud, **{name: array})


def without_odd() -> GaussianCloud:
    cloud = make_cloud(COUNT)
    return GaussianCloud(*(np.ascontiguousarray(getattr(cloud, name)[ODD.stop :]) for name in NAMES))


def check_finite(outcome: Outcome) -> None:
    assert torch.isfinite(outcome.image).all()
    assert ((outcome.transmittance >= 0) & (outcome.transmittance <= 1)).all()
    for name in NAMES:
        assert torch.isfinite(outcome.gradients[name]).all(), name


def check_reference(cloud: GaussianCloud, camera: Camera = CAMERA, bound: float = 1e-4) -> None:
    """Finite, and equal to the float64 reference."""
    found, wanted = run(cloud, camera), run(cloud, camera, "reference")
    check_finite(found)
    check_finite(wanted)
    assert float((found.image - wanted.image).abs().max()) < 1e-4
    for name in NAMES:
        assert relative(found.gradients[name], wanted.gradients[name]) < bound, name


CULLED = [
    *((name, value) for name in NAMES for value in (np.nan, np.inf, -np.inf)),
    ("quaternions", 0.0),
    ("opacities", 0.0),
    ("opacities", -0.5),
    ("scales", 1e18),
    ("scales", 3e38),
    ("means", 1e30),
    ("colours", 1e32),
]


@pytest.mark.parametrize(("name", "value"), CULLED)
def test_unusable_gaussians_are_left_out(name: str, value: float) -> None:
    cloud = odd(name, value)
    for backend in ("cpu", "reference"):
        found, wanted = run(cloud, CAMERA, backend), run(without_odd(), CAMERA, backend)
        check_finite(found)
        assert torch.equal(found.image, wanted.image)
        assert not any(found.gradients[n][ODD].any() for n in NAMES)
        assert torch.equal(found.probe.visible, wanted.probe.visible + ODD.stop)


@pytest.mark.parametrize("side", [(1, 0), (-1, 0), (0, 1), (0, -1)])
@pytest.mark.parametrize("aside", [0.95, 1.3, 40.0])
def test_what_lies_far_beside_the_picture_does_not_cover_it(side: tuple[int, int], aside: float) -> None:
    """Up to a picture's size from its middle Gaussians are drawn as the reference draws them, far beyond not at all."""
    cloud, depth = make_cloud(COUNT), 1.5
    place = np.array([0.5 + aside * side[0], 0.5 + aside * side[1], 1]) * (CAMERA.width, CAMERA.height, 1)
    at_camera = np.append(depth * np.linalg.solve(CAMERA.intrinsics, place), 1)
    means, scales = cloud.means.copy(), cloud.scales.copy()
    means[ODD] = (np.linalg.inv(CAMERA.world_to_camera) @ at_camera)[:3]
    scales[ODD] = (20, 20, 0.1) if aside > 1 else (2, 2, 0.1)
    beside = replace(cloud, means=means, scales=scales, quaternions=sheets(cloud, 1).quaternions)
    others = GaussianCloud(*(np.ascontiguousarray(getattr(beside, name)[ODD.stop :]) for name in NAMES))
    if aside < 1:
        check_reference(beside)
    for backend in ("cpu", "reference"):
        found, wanted = run(beside, CAMERA, backend), run(others, CAMERA, backend)
        assert torch.equal(found.image, wanted.image) == (aside > 1)
        assert any(found.gradients[n][ODD].any() for n in NAMES) == (aside < 1)


def test_a_narrow_field_of_view_leaves_out_nothing() -> None:
    """Zoomed in, a wide Gaussian several pictures aside is drawn as the reference draws it, and reaches the picture."""
    intrinsics = CAMERA.intrinsics.copy()
    intrinsics[:2, :2] *= 8
    camera, cloud = replace(CAMERA, intrinsics=intrinsics), make_cloud(COUNT)
    means = cloud.means.copy()
    means[ODD] = (np.linalg.inv(camera.world_to_camera) @ (0.5, 0, 2, 1))[:3]
    wide = replace(cloud, means=means, scales=sheets(cloud, 0.5).scales, quaternions=sheets(cloud, 1).quaternions)
    check_reference(wide, camera)
    assert run(wide, camera).gradients["means"][ODD].any()


@pytest.mark.parametrize("spread", [0.45, 0.55, 40.0])
@pytest.mark.parametrize("aside", [0.0, 1.2])
def test_what_reaches_far_along_the_view_does_not_cover_it(spread: float, aside: float) -> None:
    """A standard deviation up to half the depth is drawn as the reference draws it, more is not drawn."""
    cloud, depth = make_cloud(COUNT), 1.5
    means, scales, quaternions = cloud.means.copy(), cloud.scales.copy(), cloud.quaternions.copy()
    means[ODD] = (np.linalg.inv(CAMERA.world_to_camera) @ (aside, 0.2, depth, 1))[:3]
    quaternions[ODD] = sheets(cloud, 1).quaternions[ODD]
    scales[ODD] = (0.5, 0.1, spread * depth)
    needles = replace(cloud, means=means, scales=scales, quaternions=quaternions)
    if spread < 0.5:
        check_reference(needles)
    for backend in ("cpu", "reference"):
        found, wanted = run(needles, CAMERA, backend), run(without_odd(), CAMERA, backend)
        assert torch.equal(found.image, wanted.image) == (spread > 0.5)
        assert any(found.gradients[n][ODD].any() for n in NAMES) == (spread < 0.5)


DRAWN = [
    ("scales", 0.0),
    ("scales", -0.1),
    ("scales", 1e-30),
    ("scales", 1e-4),
    ("scales", 30.0),
    ("quaternions", 1e-12),
    ("quaternions", 1e12),
    ("opacities", 1.0),
    ("opacities", 1.9),
    ("opacities", 50.0),
    ("opacities", 1 / 255 + 1e-6),
    ("colours", -3.0),
    ("colours", 1e4),
]


@pytest.mark.parametrize(("name", "value"), DRAWN)
def test_odd_gaussians_are_drawn_as_the_reference_draws_them(name: str, value: float) -> None:
    if name == "colours" and value == 1e4:  # everything scales with it, the errors too
        found, wanted = run(odd(name, value), CAMERA), run(odd(name, value), CAMERA, "reference")
        check_finite(found)
        assert relative(found.image, wanted.image) < 1e-5
        return
    check_reference(odd(name, value))


def view(depth: float, count: int = 40, size: float = 0.3) -> tuple[GaussianCloud, Camera]:
    """Gaussians about a point `depth` before a camera at the world's origin."""
    cloud = make_cloud(count, seed=2, size=size, spread=abs(depth) / 4 + 1e-3)
    camera = pinhole("origin", (45.0, 45.0), (24.0, 20.0), (48, 40), np.eye(4))
    return replace(cloud, means=cloud.means + np.float32([0, 0, depth])), camera


PLACES: dict[str, Callable[[], tuple[GaussianCloud, Camera]]] = {
    "all behind": lambda: view(-50.0),
    "on the camera centre": lambda: view(0.0),
    "at the near plane": lambda: view(0.01),
    "just before it": lambda: view(0.05, size=0.01),
    "far away": lambda: view(1e5, size=2e4),
    "none": lambda: (make_cloud(0), CAMERA),
    "one": lambda: (make_cloud(1, size=0.5, spread=0.1), CAMERA),
    "below a pixel": lambda: (make_cloud(500, size=1e-3), CAMERA),
    "one pixel": lambda: (make_cloud(50, size=0.5), make_camera(1, 1, focal=2.0)),
    "one row, 8192 wide": lambda: (make_cloud(20, size=0.1), make_camera(8192, 1, focal=6000.0)),
    "focal length 1": lambda: (make_cloud(50), make_camera(focal=1.0)),
    "focal length 1e6": lambda: (make_cloud(50), make_camera(focal=1e6)),
}


@pytest.mark.parametrize("place", PLACES)
def test_extreme_views_equal_the_reference(place: str) -> None:
    cloud, camera = PLACES[place]()
    # A Gaussian that the camera all but touches is a needle thousands of pixels long: float32 keeps three digits of it.
    close = place in ("on the camera centre", "at the near plane", "focal length 1e6")
    found, wanted = run(cloud, camera), run(cloud, camera, "reference")
    check_finite(found)
    check_finite(wanted)
    assert float((found.image - wanted.image).abs().mean()) < (1e-3 if close else 1e-6)
    if not close:
        for name in NAMES:
            assert relative(found.gradients[name], wanted.gradients[name]) < 1e-4, name


def scaled(factor: float) -> tuple[GaussianCloud, Camera]:
    cloud = make_cloud(COUNT)
    pose = CAMERA.world_to_camera.copy()
    pose[:3, 3] *= factor
    camera = replace(CAMERA, world_to_camera=pose)
    return replace(cloud, means=cloud.means * np.float32(factor), scales=cloud.scales * np.float32(factor)), camera


def test_a_scene_of_a_million_units_looks_the_same() -> None:
    big, same = render(*scaled(1e6), BACKGROUND), render(*scaled(1.0), BACKGROUND)
    assert np.abs(big.image - same.image).max() < 1e-4
    check_finite(run(*scaled(1e6)))


def test_a_scene_of_a_millionth_unit_lies_before_the_near_plane() -> None:
    assert np.array_equal(render(*scaled(1e-6), BACKGROUND).image, np.broadcast_to(BACKGROUND, (40, 48, 3)))


def sheets(cloud: GaussianCloud, width: float, camera: Camera = CAMERA) -> GaussianCloud:
    """`cloud` as thin Gaussians of standard deviation `width` that face `camera`."""
    facing = np.roll(Rotation.from_matrix(camera.world_to_camera[:3, :3].T).as_quat(), 1)  # from x y z w
    quaternions = np.tile(np.float32(facing), (len(cloud), 1))
    return replace(cloud, quaternions=quaternions, scales=np.tile(np.float32([width, width, 0.01]), (len(cloud), 1)))


def test_ten_thousand_layers_over_the_whole_screen() -> None:
    cloud = sheets(make_cloud(10_000, spread=0.3), 50)
    outcome = run(cloud, CAMERA)
    check_finite(outcome)
    assert float(outcome.transmittance.max()) < 0.11  # nothing more fits below 1e-4 / (1 - 0.999)
    assert len(outcome.probe.visible) > 5000


def test_more_layers_than_memory_holds_are_refused() -> None:
    cloud = sheets(make_cloud(200, spread=0.3), 50)
    with pytest.raises(ModelError, match="scales are out of hand"):
        render(cloud, CAMERA, BACKGROUND, most_pairs=500)


def test_a_gaussian_far_larger_than_the_screen_is_flat() -> None:
    one = make_cloud(1, spread=0.01)
    cloud = sheets(replace(one, opacities=np.full(1, 0.5, np.float32)), 1e4)
    rendered = render(cloud, CAMERA, BACKGROUND)
    assert np.abs(rendered.image - (0.5 * cloud.colours[0] + 0.5 * BACKGROUND)).max() < 1e-5


def test_light_ends_at_the_cut_off() -> None:
    """Layers of alpha 0.9 leave T = 0.1, 0.01, 0.001; a pixel ends before it would fall below 1e-4."""
    camera = pinhole("axis", (20.0, 20.0), (4.5, 4.5), (9, 9), np.eye(4))
    one = sheets(make_cloud(1), 1e3, camera)
    layers = concatenate(
        [
            replace(one, means=np.float32([[0, 0, z]]), opacities=np.float32([alpha]))
            for z, alpha in ((2, 0.9), (3, 0.9), (4, 0.9), (5, 0.91), (6, 0.89))
        ]
    )
    light = render(layers, camera, BACKGROUND).transmittance
    assert np.abs(light - 1e-3).max() < 1e-7  # 0.91 would leave 9e-5: the pixel ends before it, and 0.89 is not drawn
    check_finite(run(layers, camera))


def test_half_precision_moves_the_picture_little() -> None:
    cloud = make_cloud(COUNT)
    half = GaussianCloud(*(getattr(cloud, name).astype(np.float16).astype(np.float32) for name in NAMES))
    difference = render(half, CAMERA, BACKGROUND).image - render(cloud, CAMERA, BACKGROUND).image
    assert 0 < np.abs(difference).mean() < 1e-3
    check_reference(half)


EXTREME = st.one_of(
    st.floats(width=32),
    st.sampled_from([0.0, -0.0, 1e-38, 1e-45, 1e38, -1e38, float("nan"), float("inf"), -float("inf")]),
)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_float_gives_finite_pictures_and_gradients(data: Any) -> None:
    cloud = make_cloud(12)
    name = data.draw(st.sampled_from(NAMES))
    array = getattr(cloud, name).copy()
    for row in range(3):
        count = array[row].size
        array[row] = np.array(data.draw(st.lists(EXTREME, min_size=count, max_size=count)), np.float32).reshape(
            SHAPES[name]
        )
    outcome = run(replace(cloud, **{name: array}), CAMERA)
    check_finite(outcome)
