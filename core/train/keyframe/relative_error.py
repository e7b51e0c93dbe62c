"""Errors of the training cameras' pictures as shares of what they were, so that no camera counts more than another."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, TypeVar

import torch
from torch import Tensor

from streamlod.core.train.field.decode import Splats
from streamlod.core.train.keyframe.drawing import ViewLoss

Change = TypeVar("Change")
_LEAST = 1e-9  # squared error of a whole picture: a perfect one divides nothing by zero


class RelativeErrors(Generic[Change]):
    """What a change of the Gaussians adds to the squared errors of all usable cameras, which count alike.

    Args:
        view_loss: draws the cameras and knows their pictures.
        splats: of a camera, after a change.
    """

    def __init__(self, view_loss: ViewLoss, splats: Callable[[int, Change], Splats]) -> None:
        self._view_loss, self._splats = view_loss, splats
        self._before: dict[int, float] = {}

    def picture(self, number: int, unchanged: Change) -> Tensor:
        """[H,W,3] what camera `number` sees before the change, over the root of its squared error; differentiable."""
        raster = self._view_loss.draw(self._splats(number, unchanged), number)
        self._before[number] = max(self._view_loss.squared_error(raster, number), _LEAST)
        return raster.image / math.sqrt(self._before[number])

    @torch.no_grad()
    def added(self, change: Change) -> float:
        """Share of the squared error that comes with `change`, in the mean of the cameras, once all are pictured."""
        drawn = {number: self._view_loss.draw(self._splats(number, change), number) for number in self._before}
        ratios = [self._view_loss.squared_error(raster, n) / self._before[n] for n, raster in drawn.items()]
        return sum(ratios) / len(ratios) - 1
