"""The settings of the growth of the paper's later frames (`growing`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.setting import octree_gs, reading, setting

if TYPE_CHECKING:
    from streamlod.core.train.later_frame.comparison import Beginning
    from streamlod.core.train.later_frame.training import Hooks


@dataclass(frozen=True, slots=True)
class PaperGrowth(FramePart):
    """A later frame adds anchors with the features of those whose gradients are large."""

    name: ClassVar[str] = "gradient_growth"
    needs_gradients: ClassVar[bool] = True

    at: float = setting(
        0.3,
        "share of the frame's steps after which anchors are added, 0 to 1",
        reading(0.3, "after 30 steps (section V-A), a whole frame of three views, nothing added is trained"),
    )
    threshold: float = setting(
        2e-4,
        "view-space gradient norm from which anchors are added",
        octree_gs(2e-4, "its threshold of the gradient norm"),
    )
    share: float = setting(
        0.01,
        "added anchors a frame, at most this share of all, 0 to 1",
        reading(0.01, "no limit is given; this one bounds a packet"),
    )
    room: float = setting(
        100.0,
        "share by which the anchors of later frames may outnumber those of the first frame since the start",
        reading(100.0, "no limit is given but that of memory"),
    )

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        from streamlod.core.train.later_frame.parts.adding import allowed
        from streamlod.core.train.later_frame.training import Hooks
        from streamlod.core.train.paper.growing import Growing

        most = allowed(seen, self.share, self.room)
        return Growing(self.at, self.threshold, most, seen) if most else Hooks()
