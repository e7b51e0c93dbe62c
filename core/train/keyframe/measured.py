"""What the training cameras' pictures say of anchors: how exactly to round each, and which ones to do without.

Errors are taken as shares of what they were, so that no camera counts more than another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import Precision, usual_precision
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.keyframe.effect import anchor_effects, dispensable
from streamlod.core.train.keyframe.precision import sensitivity, signed_gradients, tuned_precision

_LEAST = 1e-9  # squared error of a whole picture: a perfect one divides nothing by zero


def precision_within(field: Field, view_loss: ViewLoss, share: float, seed: int) -> Precision:
    """The rounding that adds `share` of the squared error of every camera, on average, in as few bits as possible."""
    if len(field) <= field.feature.shape[1]:  # too few rows to say how features go together
        return usual_precision(field)
    usable = view_loss.views.usable

    def splats(number: int, leaves: tuple[Tensor, ...]) -> Splats:
        feature, offset, scaling = leaves
        changed = replace(field, feature=feature, offset=offset, scaling=scaling)
        return changed.decode(view_loss.views.centres[number])

    errors = RelativeErrors(view_loss, splats)
    found = sensitivity(signed_gradients(_leaves(field), errors.picture, usable, seed))

    def added(precision: Precision) -> float:
        return len(usable) * errors.added(_leaves(precision.rounded(field)))

    return tuned_precision(field, found, share * len(usable), added)


def effects_and_rest(field: Field, view_loss: ViewLoss, share: float, seed: int) -> tuple[Tensor, Tensor]:
    """([N] effects, [n] rows of the anchors that stay where those of least effect go).

    Args:
        share: of the squared error of every camera that may come with that, on average; 0: all stay.
    """

    def splats(number: int, present: tuple[Tensor, ...]) -> Splats:
        whole = field.decode(view_loss.views.centres[number])
        return replace(whole, opacities=whole.opacities * present[0].repeat_interleave(field.slots))

    errors, device = RelativeErrors(view_loss, splats), field.level.device
    effects = anchor_effects(len(field), errors.picture, view_loss.views.usable, seed, device)
    stays = torch.ones(len(field), dtype=torch.bool, device=device)
    if share > 0:
        stays = ~dispensable(effects, share, lambda present: errors.added((present,)))
    return effects, torch.nonzero(stays)[:, 0]


class RelativeErrors:
    """What a change of some tensors adds to the squared errors of all usable cameras, which count alike.

    Args:
        view_loss: draws the cameras and knows their pictures.
        splats: what a camera is shown, by the tensors.
    """

    def __init__(self, view_loss: ViewLoss, splats: Callable[[int, tuple[Tensor, ...]], Splats]) -> None:
        self._view_loss, self._splats = view_loss, splats
        self._before: dict[int, float] = {}

    def picture(self, number: int, unchanged: tuple[Tensor, ...]) -> Tensor:
        """[H,W,3] what camera `number` sees before the change, over the root of its squared error; differentiable."""
        raster = self._view_loss.draw(self._splats(number, unchanged), number)
        self._before[number] = max(self._view_loss.squared_error(raster, number), _LEAST)
        return raster.image / math.sqrt(self._before[number])

    @torch.no_grad()
    def added(self, changed: tuple[Tensor, ...]) -> float:
        """Share of the squared error that comes with the change, in the mean of the cameras, once all are pictured."""
        drawn = {number: self._view_loss.draw(self._splats(number, changed), number) for number in self._before}
        ratios = [self._view_loss.squared_error(raster, n) / self._before[n] for n, raster in drawn.items()]
        return sum(ratios) / len(ratios) - 1


def _leaves(field: Field) -> tuple[Tensor, Tensor, Tensor]:
    return field.feature, field.offset, field.scaling
