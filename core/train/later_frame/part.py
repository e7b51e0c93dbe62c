"""One mechanism of a later frame that can be left out: its settings and its hooks.

A part is a frozen dataclass of settings whose `begin` makes its hooks for one frame. A frame runs the hooks of all
parts of its configuration in their order (`core.train.later_frame.frame`); gsplat's strategies are the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

from torch import Tensor

from streamlod.core.render.raster import Raster
from streamlod.core.train.config import PartSettings
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.field import Field
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.state import State


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """What is known when the training of a later frame begins.

    Attributes:
        state: before the frame. rows: [n] numbers of its anchors that are trained; base: these as they were.
        pictures: of the instant. coarse: the same, at half the size where they are large.
        motion_cell: width of the cells that motion is measured in, in world units.
        bit_price: configured weight of a bit in the loss, whatever rate control makes of it.
        max_anchors: that there may be; first_count: that the first frame had; max_new: that this frame may add.
    """

    state: State
    rows: Tensor
    base: Field
    pictures: Comparison
    coarse: Comparison
    motion_cell: float
    bit_price: float
    max_anchors: int
    first_count: int
    max_new: int


class Training(Protocol):
    """What hooks may do with the anchors in training.

    Attributes:
        numbers: cameras whose pictures show any of them.
    """

    numbers: list[int]

    def begin_at(self, position: Tensor) -> None:
        """Let them begin `position` [n,3] steps from where they were."""

    def splats_at(self, number: int, position: Tensor) -> Splats:
        """Their Gaussians for a camera, if they had gone `position` [n,3] steps."""

    def draw_two(self, number: int, first: Splats, second: Splats) -> tuple[Tensor, Tensor]:
        """[h,w,3] what a camera films of Gaussians in two places, before all that is not trained.

        They need to be right only where they differ: elsewhere, neither may be drawn.
        """

    def target(self, number: int) -> Tensor:
        """[h,w,3] what a camera should film, of the size of `draw_two`."""

    def changed(self) -> Field:
        """All n as they are now, without gradients."""

    def add(self, new: dict[str, Tensor]) -> None:
        """Train `new` anchors too from now on, the seven arrays of a field; once a frame."""


class Hooks:
    """What a part does during one frame; every hook does nothing unless a part overrides it."""

    def ready(self, training: Training) -> None:
        """The pictures are planned, and no step has been taken."""

    def stepped(self, training: Training, number: int, raster: Raster, progress: float) -> None:
        """A step on camera `number` was taken, `progress` of the frame (0 to 1) is done."""


@dataclass(frozen=True, slots=True)
class FramePart(PartSettings):
    """Settings of a part, and the way to its hooks.

    Attributes:
        is_costly: left out of a frame whose time is too short for it.
    """

    is_costly: ClassVar[bool] = False

    def begin(self, seen: Beginning) -> Hooks:
        """Hooks for one frame."""
        raise NotImplementedError
