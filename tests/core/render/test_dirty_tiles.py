"""Moving Gaussians before still ones give the picture and the gradients of the full rendering."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, pinhole
from streamlod.core.render import Raster, rasterise
from streamlod.core.render.cpu.autograd import rasterise_over
from streamlod.core.render.cpu.backdrop import Backdrop, prepare
from streamlod.core.render.cpu.dirty_tiles import touched_tiles
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH, Box
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.tile_cache import make_tile_cache
from streamlod.core.train.loss.photometric import photometric_loss
from streamlod.core.train.loss.region import loss_boxes
from tests.core.render.scenes import NAMES, make_camera, make_cloud
from tests.threads import MAX_THREADS, kernel_threads

CAMERA = make_camera(200, 150)
BACKGROUND = torch.tensor([0.1, 0.2, 0.3])
PER_PIXEL = 5.0 / (0.9 * 200)  # world units at the scene's distance


def rows_of(cloud: GaussianCloud, rows: np.ndarray) -> GaussianCloud:
    return GaussianCloud(*(np.ascontiguousarray(getattr(cloud, name)[rows]) for name in NAMES))


def scene() -> tuple[GaussianCloud, GaussianCloud]:
    """A compact moving thing among 1500 others."""
    cloud = make_cloud(1600, seed=5, size=0.06)
    order = np.argsort(np.linalg.norm(cloud.means - np.array([0.5, 0.3, 0.1]), axis=1))
    return rows_of(cloud, order[:100]), rows_of(cloud, order[100:])


def moved(cloud: GaussianCloud, shift: tuple[float, float, float]) -> GaussianCloud:
    return GaussianCloud(cloud.means + np.float32(shift), *(getattr(cloud, name) for name in NAMES[1:]))


def tensors(cloud: GaussianCloud) -> list[torch.Tensor]:
    return [torch.from_numpy(getattr(cloud, name)) for name in NAMES]


def full(dynamic: list[torch.Tensor], static: GaussianCloud, camera: Camera = CAMERA) -> Raster:
    joined = (torch.cat(pair) for pair in zip(dynamic, tensors(static), strict=True))
    return rasterise(*joined, camera, BACKGROUND, gradient_rows=len(dynamic[0]))


def planned(dynamic: GaussianCloud, static: GaussianCloud, room: float) -> Backdrop:
    base = full(tensors(dynamic), static).image.numpy()
    return prepare(static, CAMERA, touched_tiles(CAMERA, dynamic, room), touched_tiles(CAMERA, dynamic), base)


@pytest.fixture
def one_thread() -> Iterator[None]:
    """With more, sums over workers split differently."""
    with kernel_threads(1):
        yield


def differentiated(raster: Raster, leaves: list[torch.Tensor], region: tuple[Box, ...] | None) -> list[torch.Tensor]:
    """Gradients of the photometric loss against a random picture, by the leaves and the projected means."""
    target = torch.rand(150, 200, 3, generator=torch.Generator().manual_seed(1))
    (photometric_loss(raster.image, target, region=region) + raster.transmittance.mean()).backward()
    gradients = [leaf.grad for leaf in leaves]
    assert all(gradient is not None and gradient.abs().max() > 0 for gradient in gradients)
    return [gradient for gradient in gradients if gradient is not None] + [raster.probe.gradients]


@pytest.mark.usefixtures("one_thread")
def test_step_equals_the_full_step_bit_by_bit() -> None:
    dynamic, static = scene()
    backdrop = planned(dynamic, static, 6.0)
    region = loss_boxes(backdrop.tile_mask, CAMERA)
    assert 0.05 < backdrop.tile_mask.mean() < 0.7
    assert len(backdrop.records) < 0.9 * len(static)
    now = moved(dynamic, (0.01, 0.0, -0.01))  # as after an optimiser's step
    ours, wanted = ([t.clone().requires_grad_() for t in tensors(now)] for _ in range(2))
    found, whole = rasterise_over(*ours, backdrop, BACKGROUND), full(wanted, static)
    assert found is not None
    assert torch.equal(found.image, whole.image)
    assert torch.equal(found.probe.visible, whole.probe.visible)
    for part, other in zip(differentiated(found, ours, region), differentiated(whole, wanted, region), strict=True):
        assert torch.equal(part, other)


@pytest.mark.usefixtures("one_thread")
def test_gaussians_at_one_depth_are_drawn_in_the_full_order() -> None:
    """Still and moving ones in one plane: moving ones come first, as their rows do."""
    camera = pinhole("axis", (150.0, 150.0), (100.0, 75.0), (200, 150), np.eye(4))
    cloud = make_cloud(600, seed=3, size=0.1)
    means = cloud.means.copy()
    means[:, 2] = 4.0
    cloud = GaussianCloud(means, *(getattr(cloud, name) for name in NAMES[1:]))
    dynamic, static = rows_of(cloud, np.arange(60)), rows_of(cloud, np.arange(60, 600))
    everywhere = np.ones_like(touched_tiles(camera, dynamic))
    whole = full(tensors(dynamic), static, camera).image
    backdrop = prepare(static, camera, everywhere, everywhere, whole.numpy())
    found = rasterise_over(*tensors(dynamic), backdrop, BACKGROUND)
    assert found is not None
    assert torch.equal(found.image, whole)


@pytest.mark.parametrize("threads", [1, 2])
def test_picture_is_that_of_any_number_of_threads(threads: int) -> None:
    dynamic, static = scene()
    backdrop, whole = planned(dynamic, static, 4.0), full(tensors(dynamic), static).image
    with kernel_threads(min(threads, MAX_THREADS)):
        found = rasterise_over(*tensors(dynamic), backdrop, BACKGROUND)
    assert found is not None
    assert torch.equal(found.image, whole)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("pixels", [0.5, 30.0, 2000.0])
def test_stage_follows_gaussians_that_leave_their_room(pixels: float) -> None:
    dynamic, static = (Splats(*tensors(cloud)) for cloud in scene())
    cache = make_tile_cache(CAMERA, dynamic, static, BACKGROUND, "cpu")
    now = moved(scene()[0], (pixels * PER_PIXEL, 0.0, 0.0))
    ours, wanted = ([t.clone().requires_grad_() for t in tensors(now)] for _ in range(2))
    raster, wider = cache.render(Splats(*ours))
    whole = full(wanted, scene()[1])
    assert (wider is cache) == (pixels != 30.0)  # out of the picture they reach no tile
    assert torch.equal(raster.image, whole.image)
    if pixels < 100:  # further away nothing is seen of them
        assert wider.region is not None
        for part, other in zip(
            differentiated(raster, ours, wider.region), differentiated(whole, wanted, wider.region), strict=True
        ):
            assert torch.equal(part, other)


@pytest.mark.parametrize("seed", range(3))
def test_touched_tiles_are_those_that_change(seed: int) -> None:
    cloud, background = make_cloud(40, seed=seed, size=0.1, spread=2.0), torch.zeros(3)
    mask = touched_tiles(CAMERA, cloud)
    light = rasterise(*tensors(cloud), CAMERA, background).transmittance
    changed = np.zeros_like(mask)
    for y, x in zip(*np.nonzero(light.numpy() < 1), strict=True):
        changed[y // TILE_HEIGHT, x // TILE_WIDTH] = True
    assert not (changed & ~mask).any()
    assert (mask & ~changed).sum() <= 0.1 * mask.sum() + 1  # an ellipse may pass between pixel centres


def test_room_to_move_is_kept_and_leaving_it_is_noticed() -> None:
    dynamic, static = scene()
    backdrop = planned(dynamic, static, 8.0)

    def fits(shift: tuple[float, float, float]) -> bool:
        return rasterise_over(*tensors(moved(dynamic, shift)), backdrop, BACKGROUND) is not None

    for angle in np.linspace(0, 2 * np.pi, 8):
        assert fits((5 * PER_PIXEL * np.cos(angle), 5 * PER_PIXEL * np.sin(angle), 0.0))
    assert not fits((60 * PER_PIXEL, 0.0, 0.0))


def test_gaussians_that_may_enter_from_outside_have_their_tiles() -> None:
    one = make_cloud(1, size=0.02)
    camera = make_camera(200, 150)
    inverse = np.linalg.inv(camera.world_to_camera)
    focal, centre = camera.intrinsics[0, 0], camera.intrinsics[0, 2]
    outside = inverse[:3, :3] @ np.array([(-6.0 - centre) / focal * 5, 0.0, 5.0]) + inverse[:3, 3]
    one = GaussianCloud(
        np.float32(outside)[None], one.quaternions, one.scales * 0 + 0.005, np.ones(1, np.float32), one.colours
    )
    assert not touched_tiles(camera, one).any()
    assert touched_tiles(camera, one, 8.0)[:, 0].any()


def test_only_what_reaches_the_mask_is_listed() -> None:
    cloud = make_cloud(200, seed=8, size=0.1)
    mask = np.zeros_like(touched_tiles(CAMERA, cloud))
    mask[4, 2] = mask[5, 4] = True
    near = len(prepare(cloud, CAMERA, mask, mask, np.zeros((150, 200, 3), np.float32)).records)
    assert 0 < near < len(cloud) / 2
    leaves = [[t.clone().requires_grad_() for t in tensors(cloud)] for _ in range(2)]
    part = rasterise(*leaves[0], CAMERA, BACKGROUND, tile_mask=torch.from_numpy(mask))
    whole = rasterise(*leaves[1], CAMERA, BACKGROUND)
    pixels = torch.from_numpy(mask).repeat_interleave(TILE_HEIGHT, 0).repeat_interleave(TILE_WIDTH, 1)[:150, :200, None]
    assert torch.equal(part.image * pixels, whole.image * pixels)
    assert torch.equal(part.probe.visible, whole.probe.visible)  # in view, whatever is drawn
    for raster in (part, whole):
        raster.image.backward(torch.rand(150, 200, 3, generator=torch.Generator().manual_seed(2)) * pixels)
    for found, wanted in zip(leaves[0], leaves[1], strict=True):
        assert found.grad is not None
        assert wanted.grad is not None
        assert torch.allclose(found.grad, wanted.grad, rtol=1e-5, atol=1e-7)
    assert torch.allclose(part.probe.gradients, whole.probe.gradients, rtol=1e-5, atol=1e-7)
    assert 0 < int((part.probe.gradients.abs().sum(dim=1) > 0).sum()) <= near


@pytest.mark.usefixtures("one_thread")
def test_what_has_moved_since_the_known_picture_is_not_left_standing_in_it() -> None:
    dynamic, static = scene()
    known = full(tensors(dynamic), static).image
    now = Splats(*tensors(moved(dynamic, (30.0 * PER_PIXEL, 0.0, 0.0))))
    before, still = Splats(*tensors(dynamic)), Splats(*tensors(static))
    cache = make_tile_cache(CAMERA, now, still, BACKGROUND, "cpu", known, before)
    raster, _ = cache.render(now)
    assert torch.equal(raster.image, full(now.astuple(), static).image)


def test_nothing_dynamic_means_nothing_dirty() -> None:
    static = make_cloud(50)
    base = torch.rand(150, 200, 3)
    cache = make_tile_cache(CAMERA, Splats(*tensors(make_cloud(0))), Splats(*tensors(static)), BACKGROUND, "cpu", base)
    assert cache.is_empty
    assert cache.region == ()
    raster, _ = cache.render(Splats(*tensors(make_cloud(0))))
    assert torch.equal(raster.image, base)


def test_the_whole_picture_is_planned_where_most_of_it_moves() -> None:
    cloud = make_cloud(300, size=0.4)
    dynamic, static = rows_of(cloud, np.arange(150)), rows_of(cloud, np.arange(150, 300))
    cache = make_tile_cache(CAMERA, Splats(*tensors(dynamic)), Splats(*tensors(static)), BACKGROUND, "cpu")
    assert cache.region == (Box(0, 0, 200, 150),)
    raster, _ = cache.render(Splats(*tensors(dynamic)))
    assert torch.equal(raster.image, full(tensors(dynamic), static).image)
