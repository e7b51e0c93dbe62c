"""Parts of later frames, one module each; to leave one out, leave it out of the list."""

from __future__ import annotations

from streamlod.core.train.later_frame.part import Part
from streamlod.core.train.later_frame.parts.continuation import Continuation
from streamlod.core.train.later_frame.parts.flow_search import FlowSearch
from streamlod.core.train.later_frame.parts.neighbourhoods import Neighbourhoods
from streamlod.core.train.later_frame.parts.new_anchors import NewAnchors

__all__ = ["USUAL", "Continuation", "FlowSearch", "Neighbourhoods", "NewAnchors"]

USUAL: tuple[Part, ...] = (Continuation(), FlowSearch(), Neighbourhoods(), NewAnchors())
"""The parts of our presets, in the order in which their hooks run."""
