"""Anchors are added where Gaussians in training have the largest gradients: the rule of Octree-GS in later frames."""

from __future__ import annotations

import torch

from streamlod.core.render.raster import Raster
from streamlod.core.train.growth.gradient import GrowthStatistics, grow
from streamlod.core.train.growth.new_anchors import first_values
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.training import FrameTraining, Hooks


class Growing(Hooks):
    """Adds at most `most` anchors once, where gradients are beyond `threshold` when the share `at` of steps is done."""

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
