"""The settings by which later frames add anchors (`adding`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.setting import left_out, setting

if TYPE_CHECKING:
    from streamlod.core.train.later_frame.comparison import Beginning
    from streamlod.core.train.later_frame.training import Hooks

_WHY = "growth by gradients, see `gradient_growth`"


@dataclass(frozen=True, slots=True)
class AnchorGrowth(FramePart):
    """A later frame adds anchors, some of its steps after it began.

    The price of their bits stays as configured under rate control: an anchor serves for longer than a burst lasts.
    """

    name: ClassVar[str] = "new_anchors"

    at: float = setting(0.3, "share of the frame's steps after which anchors are added, 0 to 1", left_out(_WHY))
    share: float = setting(0.02, "added anchors a frame, at most this share of all, 0 to 1", left_out(_WHY))
    room: float = setting(
        0.5,
        "share by which the anchors of later frames may outnumber those of the first frame since the start: some errors"
        " never end, and attract anchors in every frame",
        left_out(_WHY),
    )

    def most_added(self, alive: int) -> int:
        """As `PartSettings.most_added`."""
        return int(self.share * alive)

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        from streamlod.core.train.later_frame.parts.adding import Adding, allowed
        from streamlod.core.train.later_frame.training import Hooks

        most = allowed(seen, self.share, self.room)
        return Adding(self.at, most, seen) if most else Hooks()
