"""Parts of later frames, one module each; to leave one out, leave it out of the list."""

from __future__ import annotations

from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.parts.flow_search import FlowSearch
from streamlod.core.train.later_frame.parts.new_anchors import AnchorGrowth

__all__ = ["USUAL", "AnchorGrowth", "FlowSearch"]

USUAL: tuple[FramePart, ...] = (FlowSearch(), AnchorGrowth())
"""The parts of our presets, in the order in which their hooks run."""
