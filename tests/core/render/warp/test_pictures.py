"""The rasteriser in Warp: pictures and gradients against the float64 reference and the Numba kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.render import rasterise
from streamlod.core.render.warp.kernels.project import project
from streamlod.core.render.warp.kernels.rules import NO_KEY
from streamlod.core.scene.gaussians import GaussianCloud
from tests.core.render.scenes import BACKGROUND, NAMES, make_camera, make_cloud
from tests.core.render.test_gradients import SCENES
from tests.core.render.warp.drawing import DEVICE, drawing

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

BOUND = 1e-4


def weights(*shape: int) -> Float32:
    return np.random.default_rng(9).normal(size=shape).astype(np.float32)


def reference(
    cloud: GaussianCloud, camera: Camera, by_image: Float32, still: GaussianCloud | None = None
) -> tuple[Float32, dict[str, Float32]]:
    """Picture and gradients of `cloud`, perhaps with `still` Gaussians, in float64."""
    rows = len(cloud.means)
    joined = cloud if still is None else join(cloud, still)
    parameters = [torch.tensor(getattr(joined, name), dtype=torch.float64).requires_grad_() for name in NAMES]
    background = torch.tensor(BACKGROUND, dtype=torch.float64)
    raster = rasterise(*parameters, camera, background, gradient_rows=rows, backend="reference")
    (raster.image * torch.from_numpy(by_image)).sum().backward()
    found = {name: p.grad[:rows].numpy() for name, p in zip(NAMES, parameters, strict=True) if p.grad is not None}
    return raster.image.detach().numpy(), found


def join(one: GaussianCloud, other: GaussianCloud) -> GaussianCloud:
    return GaussianCloud(*(np.concatenate([getattr(one, name), getattr(other, name)]) for name in NAMES))


def error(found: Float32, wanted: Float32) -> float:
    return float(np.linalg.norm(found - wanted) / max(float(np.linalg.norm(wanted)), 1e-30))


@pytest.mark.parametrize("scene", SCENES)
def test_picture_and_gradients_equal_the_reference(scene: str) -> None:
    cloud, camera = SCENES[scene]
    by_image = weights(1, camera.height, camera.width, 3)
    image, wanted = reference(cloud, camera, by_image[0])
    subject = drawing(cloud, (camera,), background=BACKGROUND)
    assert np.abs(subject.draw()[0] - image).max() < 1e-5
    found = subject.gradients(by_image)
    assert {name: error(found[name][0], wanted[name]) for name in NAMES} == pytest.approx(
        dict.fromkeys(NAMES, 0), abs=BOUND
    )
    assert subject.moving.overflow == 0


def test_moving_before_still_ones_are_drawn_as_if_sorted_together() -> None:
    moving, still, camera = make_cloud(80, seed=5), make_cloud(220, seed=6), make_camera(61, 47)
    by_image = weights(1, 47, 61, 3)
    image, wanted = reference(moving, camera, by_image[0], still)
    subject = drawing(moving, (camera,), still, background=BACKGROUND)
    assert np.abs(subject.draw()[0] - image).max() < 1e-5
    found = subject.gradients(by_image)
    assert max(error(found[name][0], wanted[name]) for name in NAMES) < BOUND


def test_two_at_one_depth_are_drawn_moving_first() -> None:
    one = make_cloud(1, seed=1, size=0.5, spread=0.0)
    red, blue = (replace(one, colours=np.array([c], np.float32), opacities=np.ones(1, np.float32)) for c in _COLOURS)
    drawn = drawing(red, (make_camera(),), blue).draw()[0]
    assert drawn[..., 0].max() > 0.9
    assert drawn[..., 2].max() < 0.3


_COLOURS = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0])


def test_views_add_their_gradients_with_each_cameras_exposure() -> None:
    cloud, cameras = make_cloud(90, seed=7), (make_camera(61, 47), make_camera(61, 47, 70.0), make_camera(61, 47, 30.0))
    gain, offset = weights(3, 3) * 0.1 + 1, weights(3, 3) * 0.02
    by_image, chosen = weights(2, 47, 61, 3), (2, 0)
    subject = drawing(cloud, cameras, None, chosen, gain=gain, offset=offset)
    drawn, total = subject.draw(), dict.fromkeys(NAMES, 0.0)
    found = subject.gradients(by_image)
    for view, number in enumerate(chosen):
        seen = replace(cloud, colours=cloud.colours * gain[number] + offset[number])
        single = drawing(seen, (cameras[number],))
        assert np.allclose(single.draw()[0], drawn[view], atol=1e-6)
        alone = {name: values[0] for name, values in single.gradients(by_image[view : view + 1]).items()}
        alone["colours"] = alone["colours"] * gain[number]
        total = {name: total[name] + alone[name] for name in NAMES}
    assert max(error(found[name][0], total[name]) for name in NAMES) < 1e-5


def test_views_may_have_gaussians_of_their_own() -> None:
    cameras = (make_camera(61, 47), make_camera(61, 47, 70.0))
    clouds = make_cloud(90, seed=7), make_cloud(90, seed=8)
    by_image = weights(2, 47, 61, 3)
    subject = drawing(clouds, cameras)
    drawn, found = subject.draw(), subject.gradients(by_image)
    for view, (cloud, camera) in enumerate(zip(clouds, cameras, strict=True)):
        single = drawing(cloud, (camera,))
        assert np.array_equal(single.draw()[0], drawn[view])
        alone = single.gradients(by_image[view : view + 1])
        assert all(np.array_equal(alone[name][0], found[name][view]) for name in NAMES)


def test_clean_tiles_show_the_base_and_reached_ones_become_dirty() -> None:
    camera, cloud = make_camera(96, 54), make_cloud(6, seed=3, size=0.05, spread=0.3)
    base = weights(1, 54, 96, 3)
    whole = drawing(cloud, (camera,), base=base).draw()[0]
    subject = drawing(cloud, (camera,), base=base, dirty=np.zeros((1, 24), np.int32))
    drawn, dirty = subject.draw()[0], subject.sight.dirty.numpy().reshape(4, 6)
    assert 0 < dirty.sum() < dirty.size
    pixels = dirty.repeat(16, 0).repeat(16, 1)[:54, :96, None] > 0
    assert np.array_equal(drawn, np.where(pixels, whole, base[0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("name", NAMES)
def test_a_broken_number_leaves_its_gaussian_out(name: str, value: float) -> None:
    cloud, camera = make_cloud(40, seed=2), make_camera(61, 47)
    values = getattr(cloud, name).copy()
    values[3] = value if name != "quaternions" or not np.isfinite(value) else 0  # of any length, but for this one
    broken = replace(cloud, **{name: values})
    image, wanted = reference(broken, camera, weights(47, 61, 3))
    subject = drawing(broken, (camera,), background=BACKGROUND)
    assert np.abs(subject.draw()[0] - image).max() < 1e-5
    found = subject.gradients(weights(1, 47, 61, 3))
    assert all(np.isfinite(found[key]).all() for key in NAMES)
    assert max(error(found[key][0], wanted[key]) for key in NAMES) < BOUND


def test_what_has_no_room_is_left_out_and_told() -> None:
    cloud, camera = make_cloud(400, seed=0), make_camera(61, 47)
    plenty = drawing(cloud, (camera,))
    plenty.draw()
    pairs = int(plenty.moving.wanted.numpy()[0])
    short = drawing(cloud, (camera,), pairs=pairs - 100)
    assert np.isfinite(short.draw()).all()
    assert short.moving.overflow == 100
    assert all(np.isfinite(values).all() for values in short.gradients(weights(1, 47, 61, 3)).values())
    exact = drawing(cloud, (camera,), pairs=pairs)
    assert np.array_equal(exact.draw(), plenty.draw())
    assert exact.moving.overflow == 0


@pytest.mark.parametrize("before", [2**31 - 1, 2**32 - 100, 2**40])
def test_pairs_beyond_all_integers_are_left_out_and_told(before: int) -> None:
    camera = make_camera(61, 47)
    subject = drawing(make_cloud(40), (camera,))
    room, sight = subject.moving, subject.sight
    room.keys.fill_(NO_KEY)
    room.wanted.fill_(before)
    given = [subject.count, subject.cloud, sight.chosen, sight.cameras, sight.grid, room.layer]
    wp.launch(project, dim=(1, 40), inputs=[*given, room.keys, room.wanted, sight.dirty], device=DEVICE)
    assert (room.keys.numpy() == NO_KEY).all()
    subject.draw()
    assert room.largest > before


@pytest.mark.parametrize("seed", range(3))
def test_ties_of_depth_are_drawn_by_row_whoever_lists_first(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a GPU, threads put their pairs into the list in any order; on the CPU always by row."""
    cloud, camera = make_cloud(40, seed=seed, size=0.4, spread=0.0), make_camera(61, 47)  # all in one place
    sort = wp.utils.radix_sort_pairs

    def shuffled(keys: Any, rows: Any, pairs: int, *bits: int) -> None:
        order = np.arange(2 * pairs)
        np.random.default_rng(seed).shuffle(order[: np.count_nonzero(keys.numpy()[:pairs] != NO_KEY)])
        for array in (keys, rows):
            array.assign(array.numpy()[order])
        sort(keys, rows, pairs, *bits)

    wanted = drawing(cloud, (camera,)).draw()
    monkeypatch.setattr(wp.utils, "radix_sort_pairs", shuffled)
    assert np.array_equal(drawing(cloud, (camera,)).draw(), wanted)


def test_nothing_to_draw_shows_the_background() -> None:
    cloud, camera = make_cloud(3), make_camera()
    hidden = replace(cloud, opacities=np.zeros(3, np.float32))
    subject = drawing(hidden, (camera,), background=BACKGROUND)
    assert np.array_equal(subject.draw()[0], np.broadcast_to(BACKGROUND, (40, 48, 3)))
    assert not any(values.any() for values in subject.gradients(weights(1, 40, 48, 3)).values())
