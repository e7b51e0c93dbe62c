"""Parts of later frames, one module each; to leave one out, leave it out of the list."""

from __future__ import annotations

from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.parts.continuation import Continuation
from streamlod.core.train.later_frame.parts.flow_search import FlowSearch
from streamlod.core.train.later_frame.parts.neighbourhoods import Neighbourhoods
from streamlod.core.train.later_frame.parts.new_anchors import AnchorGrowth

__all__ = ["USUAL", "AnchorGrowth", "Continuation", "FlowSearch", "Neighbourhoods"]

USUAL: tuple[FramePart, ...] = (Continuation(), FlowSearch(), Neighbourhoods(), AnchorGrowth())
"""The parts of our presets, in the order in which their hooks run."""
