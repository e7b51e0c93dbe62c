"""The settings of the search for where training of a later frame begins (`flow_starts`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.setting import left_out, setting

if TYPE_CHECKING:
    from streamlod.core.train.later_frame.comparison import Beginning
    from streamlod.core.train.later_frame.training import Hooks


@dataclass(frozen=True, slots=True)
class FlowSearch(FramePart):
    """Anchors begin where optical flow takes them, if rendering agrees."""

    name: ClassVar[str] = "flow_search"
    is_costly: ClassVar[bool] = True

    pixels: float = setting(
        0.5,
        "pixels that something must go in a frame for optical flow to say where training of its anchors begins",
        left_out("training begins at the frame before"),
    )

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        from streamlod.core.train.later_frame.parts.flow_starts import Searching, guessed_positions

        return Searching(guessed_positions(seen.state, seen.rows, seen.coarse, self.pixels))
