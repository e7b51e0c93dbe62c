"""Dirty tiles give the picture and the gradients of the full rendering."""

import numba
import numpy as np
import pytest
import torch

from core.gaussians import GaussianCloud, concatenate
from core.render import rasterise
from core.render.dirty import plan_dirty, static_rows, touched_tiles
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH
from core.train.losses import photometric_loss
from tests.core.render.scenes import NAMES, make_camera, make_cloud

CAMERA = make_camera(200, 150)


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


def test_step_equals_the_full_step_bit_by_bit() -> None:
    threads = numba.get_num_threads()
    numba.set_num_threads(1)  # with more, sums over workers split differently
    dynamic, static = scene()
    background, target = (
        torch.tensor([0.1, 0.2, 0.3]),
        torch.rand(150, 200, 3, generator=torch.Generator().manual_seed(1)),
    )
    plan = plan_dirty(CAMERA, dynamic, static, 6.0)
    assert plan.box is not None
    assert 0.05 < plan.share < 0.7
    assert len(plan.static_rows) < 0.9 * len(static)
    base = rasterise(*tensors(concatenate([dynamic, static])), CAMERA, background).image
    now = moved(dynamic, (0.01, 0.0, -0.01))  # as after an optimiser's step
    assert plan.covers(now)
    gradients, pictures = [], []
    for dirty in (False, True):
        leaves = [t.clone().requires_grad_() for t in tensors(now)]
        others = tensors(rows_of(static, plan.static_rows) if dirty else static)
        raster = rasterise(
            *(torch.cat([a, b]) for a, b in zip(leaves, others, strict=True)),
            CAMERA,
            background,
            gradient_rows=len(dynamic),
            tile_mask=torch.from_numpy(plan.tile_mask) if dirty else None,
            base=base if dirty else None,
        )
        photometric_loss(raster.image, target, region=plan.box if dirty else None).backward()
        pictures.append(raster.image.detach())
        gradients.append([leaf.grad for leaf in leaves] + [raster.probe.gradients])
    numba.set_num_threads(threads)
    assert torch.equal(*pictures)
    for full, part in zip(*gradients, strict=True):
        assert full is not None
        assert part is not None
        assert torch.equal(full, part)
    assert any(g is not None and g.abs().max() > 0 for g in gradients[0])


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
    plan = plan_dirty(CAMERA, dynamic, static, 8.0)
    per_pixel = 5.0 / (0.9 * 200)  # world units at the scene's distance
    for angle in np.linspace(0, 2 * np.pi, 8):
        shift = 5 * per_pixel * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert plan.covers(moved(dynamic, tuple(shift)))
    assert not plan.covers(moved(dynamic, (60 * per_pixel, 0.0, 0.0)))


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


def test_static_rows_are_those_that_reach_the_mask() -> None:
    cloud = make_cloud(200, seed=8, size=0.1)
    mask = np.zeros_like(touched_tiles(CAMERA, cloud))
    mask[4, 2] = mask[5, 4] = True
    rows = static_rows(CAMERA, cloud, mask)
    assert 0 < len(rows) < len(cloud) / 2
    pictures = [
        rasterise(*tensors(part), CAMERA, torch.zeros(3), tile_mask=torch.from_numpy(mask)).image
        for part in (cloud, rows_of(cloud, rows), rows_of(cloud, rows[1:]))
    ]
    assert torch.equal(pictures[0], pictures[1])  # the others are not needed
    assert not torch.equal(pictures[0], pictures[2])  # and the first is


def test_nothing_dynamic_means_nothing_dirty() -> None:
    plan = plan_dirty(CAMERA, make_cloud(0), make_cloud(50), 4.0)
    assert plan.box is None
    assert plan.share == 0
    assert len(plan.static_rows) == 0
    base = torch.rand(150, 200, 3)
    raster = rasterise(
        *tensors(make_cloud(0)), CAMERA, torch.zeros(3), tile_mask=torch.from_numpy(plan.tile_mask), base=base
    )
    assert torch.equal(raster.image, base)
