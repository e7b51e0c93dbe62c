"""Still Gaussians that are blended once: the pictures and gradients of blending them one by one, for less work."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.render import Raster
from streamlod.core.render.cpu.autograd import rasterise_over
from streamlod.core.render.cpu.backdrop import Backdrop, canvas_of, prepare
from streamlod.core.render.cpu.dirty_tiles import near_depths, touched_tiles
from streamlod.core.render.cpu.layers import layered
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH
from streamlod.core.scene.gaussians import GaussianCloud
from tests.core.render.scenes import make_cloud
from tests.core.render.test_dirty_tiles import BACKGROUND, CAMERA, PER_PIXEL, full, moved, pixels_of, scene, tensors
from tests.threads import MAX_THREADS, kernel_threads

ROOM = 4.0  # pixels


def planned(dynamic: GaussianCloud, static: GaussianCloud) -> tuple[Backdrop, Backdrop]:
    """The still ones one by one, and with layers."""
    near = near_depths(CAMERA, dynamic, ROOM)
    backdrop = prepare(static, CAMERA, near.tiles, full(tensors(dynamic), static).image.numpy())
    return backdrop, layered(backdrop, near)


def fainter(cloud: GaussianCloud) -> GaussianCloud:
    """`cloud`, none of it opaque: what finishes a pixel is left out when blending one by one, and must not be seen."""
    return replace(cloud, opacities=np.minimum(cloud.opacities, np.float32(0.8)))


def drawn(dynamic: list[torch.Tensor], backdrop: Backdrop) -> Raster:
    return rasterise_over(*dynamic, backdrop, BACKGROUND, canvas_of(backdrop))


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("pixels", [0.0, 3.0])
def test_pictures_and_gradients_are_those_of_the_full_step(threads: int, pixels: float) -> None:
    """Also of Gaussians that went sideways, into tiles in which they were not when the layers were made."""
    dynamic, static = (fainter(cloud) for cloud in scene())
    one_by_one, layers = planned(dynamic, static)
    assert len(layers.layers) > 50
    assert len(layers.lists) < 0.6 * len(one_by_one.lists)
    inside = pixels_of(layers.tile_mask)
    across = np.linalg.inv(CAMERA.world_to_camera)[:3, 0] * pixels * PER_PIXEL
    now = moved(dynamic, tuple(across))
    ours, wanted = ([t.clone().requires_grad_() for t in tensors(now)] for _ in range(2))
    with kernel_threads(min(threads, MAX_THREADS)):
        found, whole = drawn(ours, layers), full(wanted, static)
        torch.testing.assert_close(found.image[inside], whole.image[inside], rtol=0, atol=5e-4)
        torch.testing.assert_close(found.transmittance[inside], whole.transmittance[inside], rtol=0, atol=5e-4)
        target = torch.rand(150, 200, 3, generator=torch.Generator().manual_seed(1))
        for raster in (found, whole):
            light = raster.transmittance * 0.3
            (((raster.image - target).square() + light[..., None]) * inside[..., None]).sum().backward()
    for part, other in zip(ours, wanted, strict=True):
        assert part.grad is not None
        assert other.grad is not None
        error = (part.grad - other.grad).norm() / other.grad.norm()
        assert error < 1e-3


def sheet(camera_depth: float, colour: tuple[float, float, float], opacity: float) -> GaussianCloud:
    """Eight Gaussians at one distance that fill the middle of the picture."""
    inverse = np.linalg.inv(CAMERA.world_to_camera)
    columns = np.linspace(-0.3, 0.3, 8)
    places = np.stack([columns, np.zeros(8), np.full(8, camera_depth)], axis=1).astype(np.float32)
    one = make_cloud(8)
    means = (places @ inverse[:3, :3].T + inverse[:3, 3]).astype(np.float32)
    scales, opacities = np.full((8, 3), 0.15, np.float32), np.full(8, opacity, np.float32)
    return GaussianCloud(means, one.quaternions, scales, opacities, np.tile(np.float32(colour), (8, 1)))


def joined(*clouds: GaussianCloud) -> GaussianCloud:
    names = ("means", "quaternions", "scales", "opacities", "colours")
    return GaussianCloud(*(np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names))


@pytest.mark.parametrize("depth", [3.0, 5.0, 7.0])
def test_what_comes_into_a_tile_passes_between_what_is_there(depth: float) -> None:
    """Before a red sheet, between it and a blue one, or behind both."""
    static = joined(sheet(4.0, (1.0, 0.0, 0.0), 0.15), sheet(6.0, (0.0, 0.0, 1.0), 0.15))
    inverse = np.linalg.inv(CAMERA.world_to_camera)
    focal, centre = CAMERA.intrinsics[0, 0], CAMERA.intrinsics[0, 2]
    edge = TILE_WIDTH * round(centre / TILE_WIDTH)  # a border of two tiles near the middle
    size = 0.5 * depth / focal  # half a pixel

    def green(column: float) -> GaussianCloud:
        place = np.array([(column - centre) / focal * depth, 0.0, depth])
        one = make_cloud(1)
        means = (inverse[:3, :3] @ place + inverse[:3, 3])[None].astype(np.float32)
        colour = np.float32([[0.0, 1.0, 0.0]])
        return GaussianCloud(means, one.quaternions, np.full((1, 3), size, np.float32), np.float32([1.0]), colour)

    before, now = green(edge - 2.5), green(edge + 1.0)
    entered = touched_tiles(CAMERA, now) & ~touched_tiles(CAMERA, before)
    assert entered.any()
    _, layers = planned(before, static)
    assert len(layers.layers)
    found, whole = drawn(tensors(now), layers).image, full(tensors(now), static).image
    row = int(CAMERA.intrinsics[1, 2]) // TILE_HEIGHT * TILE_HEIGHT
    there = np.s_[row : row + TILE_HEIGHT, edge : edge + TILE_WIDTH]
    assert (whole[there] - full(tensors(before), static).image[there]).abs().max() > 0.05
    torch.testing.assert_close(found[there], whole[there], rtol=0, atol=2e-4)


def test_depths_near_a_tile_are_those_of_what_may_come_there() -> None:
    dynamic, _ = scene()
    near = near_depths(CAMERA, dynamic, ROOM)
    assert np.array_equal(near.tiles, touched_tiles(CAMERA, dynamic, ROOM))
    depths = dynamic.means @ CAMERA.world_to_camera[2, :3] + CAMERA.world_to_camera[2, 3]
    for tile in np.flatnonzero(near.tiles):
        listed = near.depths[near.offsets[tile] : near.offsets[tile + 1]]
        assert (np.diff(listed) >= 0).all()
        assert np.abs(depths[None] - listed[:, None]).min(axis=1).max() < 1e-4
    reach = [touched_tiles(CAMERA, GaussianCloud(*(part[row : row + 1].numpy() for part in tensors(dynamic))), ROOM)
             for row in range(len(dynamic))]  # fmt: skip
    assert np.array_equal(np.sum(reach, axis=0).ravel(), np.diff(near.offsets))


def test_where_nothing_moves_all_is_one_layer() -> None:
    static = fainter(scene()[1])
    nothing = GaussianCloud(*(part[:0].numpy() for part in tensors(static)))
    everywhere = np.ones_like(touched_tiles(CAMERA, nothing))
    backdrop = prepare(static, CAMERA, everywhere, np.zeros((150, 200, 3), np.float32))
    layers = layered(backdrop, near_depths(CAMERA, nothing, ROOM))
    assert np.diff(layers.offsets).max() <= 5  # too few for a layer are drawn one by one
    found = drawn(tensors(nothing), layers)
    torch.testing.assert_close(found.image, full(tensors(nothing), static).image, rtol=0, atol=5e-4)


def test_layers_that_would_not_fit_are_not_made() -> None:
    dynamic, static = scene()
    one_by_one, layers = planned(dynamic, static)
    near, count = near_depths(CAMERA, dynamic, ROOM), len(layers.layers)
    assert layered(one_by_one, near, count - 1) is one_by_one
    assert len(layered(one_by_one, near, count).layers) == count
