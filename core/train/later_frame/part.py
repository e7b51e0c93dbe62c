"""One mechanism of a later frame that can be left out: its settings and its hooks.

A part is a frozen dataclass of settings whose `begin` makes its hooks for one frame. A frame runs the hooks of all
parts of its configuration in their order (`core.train.later_frame.frame`); gsplat's strategies are the model. The
settings load no training library, so that a server can check them: `begin` imports the hooks from another module.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from streamlod.core.train.config import PartSettings

if TYPE_CHECKING:
    from streamlod.core.train.later_frame.comparison import Beginning
    from streamlod.core.train.later_frame.training import Hooks


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
