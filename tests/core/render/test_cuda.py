"""The gsplat backend against the float64 reference; on the pretend device where there is no GPU (`tests.device`)."""

import gc
import weakref

import pytest
import torch

from streamlod.core.render import rasterise
from tests.core.render.scenes import BACKGROUND, NAMES, make_camera, make_cloud, relative, run
from tests.core.render.test_extremes import CAMERA, CULLED, DRAWN, ODD, PLACES, check_finite, odd, without_odd

pytestmark = pytest.mark.cuda


@pytest.mark.parametrize("seed", range(3))
def test_picture_and_gradients_equal_the_reference(seed: int, gpu: str) -> None:
    cloud, camera = make_cloud(400, seed=seed), make_camera(61, 47)
    found, wanted = run(cloud, camera, "cuda", device=gpu), run(cloud, camera, "reference")
    assert float((found.image - wanted.image).abs().max()) < 5e-3  # a contribution at 1/255 may or may not count
    assert float((found.image - wanted.image).abs().mean()) < 1e-5
    for name in NAMES:
        assert relative(found.gradients[name], wanted.gradients[name]) < 1e-3, name


def test_probe_counts_in_halves_of_the_picture(gpu: str) -> None:
    cloud, camera = make_cloud(100), make_camera(61, 47)
    found, wanted = run(cloud, camera, "cuda", device=gpu), run(cloud, camera, "cpu")
    both = sorted(set(found.probe.visible.tolist()) & set(wanted.probe.visible.tolist()))
    assert len(both) > 50
    for k in both:
        a = found.probe.gradients[found.probe.visible.cpu() == k].cpu()
        b = wanted.probe.gradients[wanted.probe.visible == k]
        assert torch.allclose(a, b, rtol=1e-2, atol=1e-2)


def test_a_picture_leaves_nothing_behind(gpu: str) -> None:
    cloud, camera = make_cloud(100), make_camera(61, 47)
    parameters = [torch.tensor(getattr(cloud, name), device=gpu, requires_grad=True) for name in NAMES]
    gc.collect()
    gc.disable()  # whose rounds come too seldom for a GPU: a frame draws some eighty pictures
    try:
        raster = rasterise(*parameters, camera, torch.tensor(BACKGROUND, device=gpu), backend="cuda")
        raster.image.sum().backward()  # type: ignore[no-untyped-call]
        assert len(raster.probe.gradients) > 50
        known = [weakref.ref(raster.probe), weakref.ref(raster.image)]
        del raster
        assert [each() for each in known] == [None, None]
    finally:
        gc.enable()


def test_only_the_first_rows_get_gradients(gpu: str) -> None:
    outcome = run(make_cloud(100), make_camera(), "cuda", gradient_rows=30, device=gpu)
    for name in NAMES:
        assert not outcome.gradients[name][30:].any()
    assert int(outcome.probe.visible.max()) < 30


def test_nothing_to_draw_gives_the_background(gpu: str) -> None:
    outcome = run(make_cloud(0), make_camera(), "cuda", device=gpu)
    assert float((outcome.image - torch.tensor(BACKGROUND).double()).abs().max()) < 1e-7


@pytest.mark.parametrize(("name", "value"), CULLED)
def test_unusable_gaussians_are_left_out(name: str, value: float, gpu: str) -> None:
    found, wanted = (run(cloud, CAMERA, "cuda", device=gpu) for cloud in (odd(name, value), without_odd()))
    check_finite(found)
    assert torch.allclose(found.image, wanted.image, atol=1e-6)
    assert not any(found.gradients[n][ODD].any() for n in NAMES)


@pytest.mark.parametrize(("name", "value"), DRAWN)
def test_odd_gaussians_are_drawn_as_the_reference_draws_them(name: str, value: float, gpu: str) -> None:
    found, wanted = run(odd(name, value), CAMERA, "cuda", device=gpu), run(odd(name, value), CAMERA, "reference")
    check_finite(found)
    assert relative(found.image, wanted.image) < 1e-3


@pytest.mark.parametrize("place", PLACES)
def test_extreme_views_are_finite(place: str, gpu: str) -> None:
    check_finite(run(*PLACES[place](), "cuda", device=gpu))
