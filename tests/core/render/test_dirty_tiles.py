"""Moving Gaussians before still ones give the picture and the gradients of the full rendering."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from streamlod.core.camera import Camera, pinhole
from streamlod.core.render import Raster, rasterise
from streamlod.core.render.cpu.autograd import rasterise_over
from streamlod.core.render.cpu.backdrop import Backdrop, canvas_of, prepare
from streamlod.core.render.cpu.dirty_tiles import reached_tiles, touched_tiles
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH, Box
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.autograd.tile_cache import make_tile_cache
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
    return prepare(static, CAMERA, touched_tiles(CAMERA, dynamic, room), base)


def drawn(dynamic: list[torch.Tensor], backdrop: Backdrop) -> Raster:
    return rasterise_over(*dynamic, backdrop, BACKGROUND, canvas_of(backdrop))


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
    found, whole = drawn(ours, backdrop), full(wanted, static)
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
    backdrop = prepare(static, camera, everywhere, whole.numpy())
    assert torch.equal(drawn(tensors(dynamic), backdrop).image, whole)


@pytest.mark.parametrize("threads", [1, 2])
def test_picture_is_that_of_any_number_of_threads(threads: int) -> None:
    dynamic, static = scene()
    backdrop, whole = planned(dynamic, static, 4.0), full(tensors(dynamic), static).image
    with kernel_threads(min(threads, MAX_THREADS)):
        found = drawn(tensors(dynamic), backdrop)
    assert torch.equal(found.image, whole)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("pixels", [0.5, 30.0, 2000.0])
def test_other_tiles_stay_as_they_are_whatever_reaches_them(pixels: float) -> None:
    """In the tiles that are drawn, picture and gradients are those of the full step; the others count as still."""
    dynamic, static = scene()
    backdrop = planned(dynamic, static, 4.0)
    inside = pixels_of(backdrop.tile_mask)
    now = moved(dynamic, (pixels * PER_PIXEL, 0.0, 0.0))
    ours, wanted = ([t.clone().requires_grad_() for t in tensors(now)] for _ in range(2))
    found, whole = drawn(ours, backdrop), full(wanted, static)
    assert torch.equal(found.image[inside], whole.image[inside])
    assert torch.equal(found.image[~inside], torch.from_numpy(backdrop.base)[~inside])
    target = torch.rand(150, 200, 3, generator=torch.Generator().manual_seed(1))
    weights = inside[..., None].float()
    for raster in (found, whole):
        ((raster.image - target).square() * weights).sum().backward()
    for part, other in zip(ours, wanted, strict=True):
        assert part.grad is not None
        assert other.grad is not None
        torch.testing.assert_close(part.grad, other.grad, rtol=1e-4, atol=1e-5)


@pytest.mark.usefixtures("one_thread")
def test_two_pictures_are_drawn_where_they_differ() -> None:
    dynamic, static = scene()
    elsewhere = moved(dynamic, (12 * PER_PIXEL, 0.0, 0.0))
    some = np.arange(100)[:, None] < 8  # these move, the others stay
    means = np.where(some, elsewhere.means, dynamic.means)
    second = GaussianCloud(means, *(getattr(dynamic, name) for name in NAMES[1:]))
    ours, wanted = (
        [Splats(*(t.clone().requires_grad_() for t in tensors(cloud))) for cloud in (dynamic, second)] for _ in range(2)
    )
    cache = make_tile_cache(CAMERA, ours[0], Splats(*tensors(static)), BACKGROUND, "cpu")
    found = cache.render_two(*ours)
    whole = [full(list(splats.astuple()), static) for splats in wanted]
    assert cache.backdrop is not None
    inside = pixels_of(cache.backdrop.tile_mask)
    assert torch.equal((found[0].image - found[1].image)[inside], (whole[0].image - whole[1].image)[inside])
    differs = (whole[0].image != whole[1].image).any(dim=2) & inside
    assert 0 < differs.sum() < 0.7 * inside.sum()
    for raster, other, splats, others in zip(found, whole, ours, wanted, strict=True):
        assert torch.equal(raster.image[differs], other.image[differs])
        upstream = differs[..., None].float().expand(-1, -1, 3)
        (gradient,) = torch.autograd.grad(raster.image, splats.colours, upstream)
        (right,) = torch.autograd.grad(other.image, others.colours, upstream)
        torch.testing.assert_close(gradient, right, rtol=1e-5, atol=1e-5)
        assert gradient.abs().max() > 0


def pixels_of(tiles: np.ndarray) -> torch.Tensor:
    """[H,W] bool: the pixels of tiles of `CAMERA`."""
    wide = torch.from_numpy(tiles).repeat_interleave(TILE_HEIGHT, 0).repeat_interleave(TILE_WIDTH, 1)
    return wide[: CAMERA.height, : CAMERA.width]


@pytest.mark.parametrize("seed", range(3))
def test_reached_tiles_are_counted(seed: int) -> None:
    cloud = make_cloud(40, seed=seed, size=0.1, spread=2.0)
    tiles = np.zeros_like(touched_tiles(CAMERA, cloud))
    tiles[2:5, 3:7] = True
    counts, seen = reached_tiles(CAMERA, cloud, tiles), np.zeros((40, 2), np.int64)
    for row in range(40):
        alone = [part[row : row + 1] for part in tensors(cloud)]
        dark = np.argwhere(rasterise(*alone, CAMERA, torch.zeros(3)).transmittance.numpy() < 1)
        there = np.zeros_like(tiles)
        there[dark[:, 0] // TILE_HEIGHT, dark[:, 1] // TILE_WIDTH] = True
        seen[row] = there.sum(), (there & tiles).sum()
    assert (counts >= seen).all()
    assert (counts - seen).sum() <= 0.1 * counts.sum() + 2  # an ellipse may pass between pixel centres
    assert counts[:, 0].max() > 4
    assert counts[:, 1].any()


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


def test_room_to_move_is_kept() -> None:
    dynamic, static = scene()
    backdrop = planned(dynamic, static, 8.0)
    for angle in np.linspace(0, 2 * np.pi, 8):
        there = moved(dynamic, (5 * PER_PIXEL * np.cos(angle), 5 * PER_PIXEL * np.sin(angle), 0.0))
        assert not (touched_tiles(CAMERA, there) & ~backdrop.tile_mask).any()


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
    near = len(prepare(cloud, CAMERA, mask, np.zeros((150, 200, 3), np.float32)).records)
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


def test_nothing_dynamic_means_nothing_dirty() -> None:
    static = make_cloud(50)
    base = torch.rand(150, 200, 3)
    nothing, still = Splats(*tensors(make_cloud(0))), Splats(*tensors(static))
    cache = make_tile_cache(CAMERA, nothing, still, BACKGROUND, "cpu", base=base)
    assert cache.is_empty
    assert cache.region == ()
    assert torch.equal(cache.render(nothing).image, base)


def test_the_whole_picture_is_planned_where_most_of_it_moves() -> None:
    cloud = make_cloud(300, size=0.4)
    dynamic, static = rows_of(cloud, np.arange(150)), rows_of(cloud, np.arange(150, 300))
    cache = make_tile_cache(CAMERA, Splats(*tensors(dynamic)), Splats(*tensors(static)), BACKGROUND, "cpu")
    assert cache.region == (Box(0, 0, 200, 150),)
    raster = cache.render_exactly(Splats(*tensors(dynamic)))
    assert torch.equal(raster.image, full(tensors(dynamic), static).image)
