"""Errors of the training cameras' pictures as shares of what they were, so that no camera counts more than another."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from streamlod.core.train.field.decode import Splats
from streamlod.core.train.keyframe.drawing import ViewLoss

_LEAST = 1e-9  # squared error of a whole picture: a perfect one divides nothing by zero


class RelativeErrors:
    """What a change of the Gaussians adds to squared errors.

    Args:
        view_loss: draws the cameras and knows their pictures.
        views: at least one, which count alike.
    """

    def __init__(self, view_loss: ViewLoss, views: list[int]) -> None:
        self._view_loss, self._views = view_loss, views
        self._before: dict[int, float] = {}

    def picture(self, number: int, splats: Splats) -> Tensor:
        """[H,W,3] what camera `number` sees before the change, over the root of its squared error; differentiable."""
        raster = self._view_loss.draw(splats, number)
        self._before[number] = max(self._view_loss.squared_error(raster, number), _LEAST)
        return raster.image / math.sqrt(self._before[number])

    @torch.no_grad()
    def added(self, splats: Callable[[int], Splats]) -> float:
        """Share of the squared error that comes with `splats` of each camera, in the mean, once all are pictured."""
        ratios = [
            self._view_loss.squared_error(self._view_loss.draw(splats(number), number), number) / self._before[number]
            for number in self._views
        ]
        return sum(ratios) / len(ratios) - 1
