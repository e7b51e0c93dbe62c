"""Anchors are added where Gaussians in training have the largest gradients: the rule of Octree-GS in later frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch

from streamlod.core.render.raster import Raster
from streamlod.core.train.growth.gradient import GrowthStatistics, grow
from streamlod.core.train.growth.new_anchors import first_values
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.parts.new_anchors import allowed
from streamlod.core.train.later_frame.training import FrameTraining, Hooks
from streamlod.core.train.setting import octree_gs, reading, setting


@dataclass(frozen=True, slots=True)
class PaperGrowth(FramePart):
    """A later frame adds anchors with the features of those whose gradients are large."""

    name: ClassVar[str] = "gradient_growth"
    adds_anchors: ClassVar[bool] = True
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
        most = allowed(seen, self.share, self.room)
        return _Growing(self.at, self.threshold, most, seen) if most else Hooks()


class _Growing(Hooks):
    def __init__(self, at: float, threshold: float, most: int, seen: Beginning) -> None:
        self._at, self._threshold, self._most, self._seen = at, threshold, most, seen
        self._drawn, self._is_due = set[int](), True
        self._statistics = GrowthStatistics(len(seen.rows), seen.state.field.slots, seen.rows.device)

    def stepped(self, training: FrameTraining, number: int, raster: Raster, progress: float) -> None:
        if not self._is_due:
            return
        self._drawn.add(number)
        self._statistics.add_gradients(raster.probe)
        if progress >= self._at and len(self._drawn) == len(training.numbers):
            self._is_due = False
            every, trained = self._seen.state.field, training.anchors.by_residuals()
            gradient, highest = self._statistics.mean_gradient(), every.octree.levels - 1
            new = grow(trained, gradient, self._threshold, highest, self._most, occupied=every)
            generator = torch.Generator().manual_seed(len(self._seen.rows))
            training.anchors.add(first_values(trained, new, generator))
