"""The rasteriser in Warp behind the interface of the CPU kernels: on a GPU, it needs nothing but a driver.

Every picture takes memory of its own, and the host waits for how many pairs of Gaussian and tile there are. Steps that
are recorded do neither (`core.train.engine.warp`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
import warp as wp
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.render.cpu.listing import check_pairs
from streamlod.core.render.raster import Probe, Raster
from streamlod.core.render.warp.kernels.rules import BACKGROUND, CAMERA_NUMBERS, Cloud
from streamlod.core.render.warp.listing import TileLists, camera_rows, cloud_room, grid_of, list_gaussians, listing
from streamlod.core.render.warp.pictures import DrawnViews, Sight, differentiate, draw

_TYPES = {"means": wp.vec3, "quaternions": wp.vec4, "scales": wp.vec3, "opacities": wp.float32, "colours": wp.vec3}


def rasterise_warp(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    camera: Camera,
    background: Tensor,
    gradient_rows: int | None,
) -> Raster:
    """`core.render.differentiable.rasterise` with Warp's kernels; arguments as there, tensors on one device.

    Raises:
        ModelError: the Gaussians are so large that their lists would not fit.
    """
    wp.init()
    parameters = (means, quaternions, scales, opacities, colours)
    moving = len(means) if gradient_rows is None else gradient_rows
    with torch.no_grad():
        sight = _sight(camera, background)
        first, behind = (_listed([value[rows] for value in parameters], sight) for rows in _halves(moving))
    shown = _tensor(first.lists.layer.place)[0, :moving, 2] > 0
    probe = Probe(torch.arange(moving, device=means.device), shown)
    image, light = _Rasterised.apply(  # type: ignore[no-untyped-call]
        *parameters, _Picture(camera, sight, first, behind.lists, probe, moving)
    )
    return Raster(image, light, probe)


def _halves(moving: int) -> tuple[slice, slice]:
    """Rows that get gradients, and the others."""
    return slice(None, moving), slice(moving, None)


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """Gaussians: `cloud` [1,n], `count` [1] of them, and their lists."""

    cloud: Any
    count: Any
    lists: TileLists


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """All that drawing a picture and differentiating it need.

    Attributes:
        moving: Gaussians that get gradients, the first `rows` of all; still: lists of the others.
    """

    camera: Camera
    sight: Sight
    moving: _Layer
    still: TileLists
    probe: Probe
    rows: int

    @property
    def device(self) -> str:
        return str(self.sight.chosen.device)


class _Rasterised(torch.autograd.Function):
    """The picture [H,W,3], and what of the background shows [H,W]."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> tuple[Tensor, Tensor]:
        parameters, picture = given[:5], given[5]
        shape, place = (1, picture.camera.height, picture.camera.width), parameters[0].device
        image, light = torch.empty(*shape, 3, device=place), torch.empty(shape, device=place)
        nothing = wp.zeros((0, 0, 0), dtype=float, device=picture.device)  # gradients come later
        out = DrawnViews(wp.from_torch(image, dtype=wp.vec3), wp.from_torch(light), nothing, nothing, nothing)
        draw(picture.moving.lists, picture.still, picture.sight, out, picture.device)
        ctx.picture, ctx.out, ctx.shapes = picture, out, [parameter.shape for parameter in parameters]
        ctx.set_materialize_grads(False)
        return image[0], light[0]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_image: Tensor | None, by_light: Tensor | None) -> tuple[Tensor | None, ...]:
        picture, layer, room = ctx.picture, ctx.picture.moving, max(ctx.picture.rows, 1)
        out = replace(
            ctx.out,
            by_image=wp.zeros_like(ctx.out.image),
            by_light=wp.zeros_like(ctx.out.light),
            sums=wp.zeros((1, room, 9), dtype=float, device=picture.device),
        )
        for array, gradient in ((out.by_image, by_image), (out.by_light, by_light)):
            if gradient is not None:
                _tensor(array)[0] = gradient
        by = cloud_room(1, room, picture.device)
        lists = (layer.lists, picture.still, picture.sight, out)
        differentiate(*lists, layer.count, layer.cloud, by, picture.device)
        screen = _screen(layer.lists, out.sums)[: picture.rows]
        picture.probe.record(screen, _half(picture.camera.width, picture.camera.height, screen.device))
        found = []
        for name, shape in zip(_TYPES, ctx.shapes, strict=True):
            part = _tensor(getattr(by, name))[0, : picture.rows]
            whole = part.new_zeros(shape)
            whole[: picture.rows] = part
            found.append(whole)
        return (*found, None)


def _sight(camera: Camera, background: Tensor) -> Sight:
    """The camera, and what lies behind everything; all tiles are drawn."""
    device, place = wp.device_from_torch(background.device), background.device
    grid = grid_of(camera.width, camera.height)
    rows = _camera_rows(camera, place).clone()
    rows[0, BACKGROUND:CAMERA_NUMBERS] = background
    dirty = torch.ones(1, grid.tiles, dtype=torch.int32, device=place)
    under = torch.zeros(1, camera.height, camera.width, 3, device=place)
    cameras, tiles, shown = wp.from_torch(rows), wp.from_torch(dirty), wp.from_torch(under, dtype=wp.vec3)
    return Sight(grid, cameras, wp.zeros(1, dtype=int, device=device), tiles, shown)


def _listed(parameters: Sequence[Tensor], sight: Sight) -> _Layer:
    """Gaussians listed in memory of the size that they need, which is counted first."""
    device, number = str(sight.chosen.device), len(parameters[0])
    count = wp.full(1, number, dtype=int, device=device)
    cloud = cloud_room(1, 1, device) if number == 0 else Cloud()
    if number:
        for (name, kind), value in zip(_TYPES.items(), parameters, strict=True):
            setattr(cloud, name, wp.from_torch(value.contiguous()[None], dtype=kind))
    reached = wp.zeros_like(sight.dirty)
    seen = (sight.chosen, sight.cameras, sight.grid, reached, device)
    pairs = 1
    while True:
        lists = listing(1, max(number, 1), pairs, sight.grid, device)
        list_gaussians(lists, count, cloud, *seen)
        if not lists.overflow:
            return _Layer(cloud, count, lists)
        pairs = lists.largest
        check_pairs(pairs)


def _screen(lists: TileLists, sums: Any) -> Tensor:
    """[n,2] the loss's gradient by the projected means, in pixels."""
    conic, found = _tensor(lists.layer.conic)[0], _tensor(sums)[0]
    x, y = found[:, 4], found[:, 5]
    return -torch.stack([conic[:, 0] * x + conic[:, 1] * y, conic[:, 1] * x + conic[:, 2] * y], dim=1)


def _tensor(array: Any) -> Tensor:
    """A Warp array as a tensor of the same memory."""
    return torch.as_tensor(wp.to_torch(array))


@functools.lru_cache(maxsize=64)  # sending them each time would make the host wait
def _camera_rows(camera: Camera, device: torch.device) -> Tensor:
    return torch.from_numpy(camera_rows((camera,))).to(device)


@functools.lru_cache(maxsize=64)
def _half(width: int, height: int, device: torch.device) -> Tensor:
    """[2] half the size of a picture, in pixels."""
    return torch.tensor([width / 2, height / 2], device=device)
