"""Pictures of any Gaussians before those that stand still in the memory of a step, differentiable by colours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from streamlod.core.errors import ModelError
from streamlod.core.render.warp.listing import list_gaussians
from streamlod.core.render.warp.pictures import differentiate, draw
from streamlod.core.train.engine.warp.room import StepRoom, view_of
from streamlod.core.train.field.decode import Splats


def drawn_splats(room: StepRoom, number: int, splats: Splats) -> Tensor:
    """[H,W,3] what camera `number` films of `splats`, whose colours are exposed already; in dirty tiles only.

    The Gaussians in training are written over, until the next step.

    Raises:
        ModelError: more than there is room for.
    """
    if len(splats) > room.capacity.gaussians:
        raise ModelError(f"{len(splats)} Gaussians are to be drawn, and there is room for {room.capacity.gaussians}")
    picture: Tensor = _Drawn.apply(splats.colours, room, number, splats)  # type: ignore[no-untyped-call]
    return picture


class _Drawn(torch.autograd.Function):
    """What a backward pass needs is drawn once more, so that pictures may be made before others are differentiated."""

    @staticmethod
    def forward(ctx: Any, _colours: Tensor, room: StepRoom, number: int, splats: Splats) -> Tensor:
        ctx.drawn = room, number, splats
        return _draw(room, number, splats)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        room, number, splats = ctx.drawn
        _draw(room, number, splats)
        view_of(room.drawn.by_image)[0] = upstream
        sight = replace(room.sight, cameras=room.as_filmed)
        moving = (room.moving_count, room.cloud, room.by_cloud)
        differentiate(room.moving, room.still, sight, room.drawn, *moving, room.device)
        return view_of(room.by_cloud.colours)[0, : len(splats)].clone(), None, None, None


def _draw(room: StepRoom, number: int, splats: Splats) -> Tensor:
    sight = replace(room.sight, cameras=room.as_filmed)
    for name in ("means", "quaternions", "scales", "opacities", "colours"):
        view_of(getattr(room.cloud, name))[0, : len(splats)] = getattr(splats, name).detach()
    view_of(room.moving_count)[0] = len(splats)
    view_of(sight.chosen).fill_(number)
    seen = (sight.chosen, sight.cameras, sight.grid, sight.dirty)
    list_gaussians(room.moving, room.moving_count, room.cloud, *seen, room.device)
    draw(room.moving, room.still, sight, room.drawn, room.device)
    return view_of(room.drawn.image)[0].clone()
