"""Neighbourhoods of anchors that move together while a frame trains.

An anchor by itself sees little: where a thing has moved farther than its Gaussians reach, its gradient points anywhere,
and its colour changes instead of its place. The gradients of a whole neighbourhood say where all of it went. So each
neighbourhood has a shift and a turn that are trained beside the anchors' own positions; what is sent is their sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from streamlod.core.train.later_frame.part import Beginning, FramePart, Hooks
from streamlod.core.train.setting import left_out, setting


@dataclass(frozen=True, slots=True)
class Neighbourhoods(FramePart):
    """Anchors of one neighbourhood are shifted and turned together, beside their own positions."""

    name: ClassVar[str] = "neighbourhoods"

    rate: float = setting(
        0.2,
        "Adam's rate of the shift and turn that a neighbourhood shares, in pixels; higher than"
        " `predict.position_rate`, because what single anchors do is mostly noise, which must be sent",
        left_out("every anchor moves by itself"),
    )
    cells: float = setting(
        4.0, "width of the neighbourhoods, in motion cells", left_out("every anchor moves by itself")
    )

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        width = self.cells * seen.base.octree.motion_cell
        return _Together(self.rate, neighbourhoods(seen.base.position, width))


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Neighbourhoods of n anchors.

    Attributes:
        number: [n] int64 below `count`, the group of each anchor.
        arm: [n,3] from the mean position of its group to the anchor, in units of a group's width.
    """

    number: Tensor
    arm: Tensor
    count: int

    def at_rest(self) -> dict[str, Tensor]:
        """[count,3] float32 shifts and turns of groups that do not move."""
        return {name: torch.zeros(self.count, 3, device=self.arm.device) for name in ("shift", "turn")}

    def moved(self, own: Tensor, shift: Tensor, turn: Tensor) -> Tensor:
        """[n,3] how far each anchor goes if it goes `own` [n,3] and its group is shifted and turned by [count,3] each.

        All have one unit of length. `turn` is a small rotation vector times a group's width: an anchor moves by
        turn x arm.
        """
        moved: Tensor = _Moved.apply(own, shift, turn, self.number, self.arm)  # type: ignore[no-untyped-call]
        return moved


def _moved(own: Tensor, shift: Tensor, turn: Tensor, number: Tensor, arm: Tensor) -> Tensor:
    turned: Tensor = torch.linalg.cross(turn[number], arm)
    return own + (shift[number] + turned)


def _pulled(upstream: Tensor, arm: Tensor) -> Tensor:
    """[n,6] what each anchor asks of its group's shift and turn."""
    return torch.cat([upstream, torch.linalg.cross(arm, upstream)], dim=1)


class _Moved(torch.autograd.Function):
    """A few launches instead of autograd's ten; on any device."""

    @staticmethod
    def forward(ctx: Any, own: Tensor, shift: Tensor, turn: Tensor, number: Tensor, arm: Tensor) -> Tensor:
        ctx.save_for_backward(number, arm)
        ctx.count = len(shift)
        return _moved(own, shift, turn, number, arm)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        number, arm = ctx.saved_tensors
        by_group = upstream.new_zeros(ctx.count, 6).index_add_(0, number, _pulled(upstream, arm))
        parts = by_group.view(-1, 2, 3).transpose(0, 1).contiguous()  # one copy rather than one for each leaf
        return (upstream, *parts, None, None)


def neighbourhoods(position: Tensor, width: float) -> Groups:
    """Groups of the anchors at `position` [n,3]: those in the same cell of a grid of cells `width` wide."""
    cells, number = torch.unique((position / width).floor().long(), dim=0, return_inverse=True)
    members = torch.bincount(number, minlength=len(cells))[:, None]
    mean = torch.zeros(len(cells), 3, device=position.device).index_add_(0, number, position) / members
    return Groups(number, (position - mean[number]) / width, len(cells))


@dataclass(frozen=True, slots=True, eq=False)
class _Together(Hooks):
    rate: float
    groups: Groups

    def start(self, values: dict[str, Tensor]) -> dict[str, Tensor]:
        return values | self.groups.at_rest()

    def moved(self, own: Tensor, parameters: dict[str, Tensor]) -> Tensor:
        return self.groups.moved(own, parameters["shift"], parameters["turn"])

    def rates(self) -> dict[str, float]:
        return dict.fromkeys(("shift", "turn"), self.rate)
