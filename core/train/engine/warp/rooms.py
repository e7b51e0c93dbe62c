"""Memory of training steps, kept from frame to frame; taken anew, with some to spare, when a frame needs more."""

from __future__ import annotations

import logging
from dataclasses import fields, replace

import torch

from streamlod.core.render.cpu.listing import check_pairs
from streamlod.core.train.engine.warp.room import Capacity, room_beside, step_room
from streamlod.core.train.engine.warp.step import TrainingStep

_LEAST = {"anchors": 256, "added": 64, "still": 1024, "moving_pairs": 1 << 14, "still_pairs": 1 << 15}
_MOVING = 1.5  # times the pairs of Gaussians in training and tiles before the first step
_LOG = logging.getLogger(__name__)


class StepRooms:
    """Steps on pictures of full size and, of large ones, of half the size, which train the same numbers.

    Attributes:
        whole, half: the steps; None before `provide`, and where pictures are not trained at half the size.

    Args:
        spare: times what a frame needs, so that not every one that needs a little more records its graph anew.
        is_small: take no more than that even if it is little.
    """

    def __init__(self, device: str, spare: float = 1.25, *, is_small: bool = False) -> None:
        self._device, self._spare = device, spare
        self._least = dict.fromkeys(_LEAST, 1) if is_small else _LEAST
        self.whole: TrainingStep | None = None
        self.half: TrainingStep | None = None

    def provide(self, need: Capacity, half: tuple[int, int] | None) -> bool:
        """Make room for `need`, and beside it for pictures of the width and height `half`.

        Returns whether memory was taken anew, and is empty.
        """
        has = None if self.whole is None else self.whole.room.capacity
        if has is not None and _fits(need, has) and self._half_size() == half:
            return False
        enough = replace(
            need, **{name: max(least, round(self._spare * getattr(need, name))) for name, least in self._least.items()}
        )
        if has is not None and (has.width, has.height, has.slots) == (need.width, need.height, need.slots):
            enough = replace(enough, **{name: max(getattr(enough, name), getattr(has, name)) for name in _LEAST})
        _LOG.debug("memory of training steps: %s", enough)
        self.whole = self.half = None  # what there was goes first: not both fit everywhere
        torch.cuda.empty_cache()  # torch keeps memory that it no longer uses, which Warp then cannot have
        whole = step_room(enough, self._device)
        self.whole = TrainingStep(whole)
        if half is not None:
            self.half = TrainingStep(room_beside(whole, *half, enough.moving_pairs, enough.still_pairs))
        return True

    @property
    def steps(self) -> list[TrainingStep]:
        """Those that there are."""
        return [step for step in (self.whole, self.half) if step is not None]

    def counted(self, need: Capacity) -> Capacity:
        """`need` with the pairs of Gaussian and tile that there were so far: half as many more may come in a step.

        Raises:
            ModelError: the Gaussians are so large that their lists would not fit.
        """
        moving = max((step.room.moving.largest for step in self.steps), default=0)
        still = max((step.room.still.largest for step in self.steps), default=0)
        check_pairs(max(moving, still))
        return replace(need, moving_pairs=round(_MOVING * moving), still_pairs=still)

    @property
    def overflow(self) -> int:
        """Pairs of Gaussians in training that had no room."""
        return max((step.room.moving.overflow for step in self.steps), default=0)

    def _half_size(self) -> tuple[int, int] | None:
        if self.half is None:
            return None
        return self.half.room.capacity.width, self.half.room.capacity.height


def _fits(need: Capacity, has: Capacity) -> bool:
    """Whether all sizes are the same and all capacities are enough."""
    sizes = [field.name for field in fields(Capacity) if field.name not in _LEAST and field.name != "steps"]
    same = all(getattr(need, name) == getattr(has, name) for name in sizes)
    return same and all(getattr(need, name) <= getattr(has, name) for name in (*_LEAST, "steps"))
