"""Rules that say where a later frame adds anchors, by name.

To add one, write a frozen dataclass with the method of `LaterGrowth` here and name it in `LATER_RULES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from streamlod.core.errors import unknown_name
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.errors import ANCHOR_BITS, error_nodes, values_at
from streamlod.core.train.growth.gradient import GrowthStatistics
from streamlod.core.train.growth.new_anchors import first_values
from streamlod.core.train.growth.rules import GradientGrowth
from streamlod.core.train.pictures.views import Views

_ANCHOR_BIT = 5 / 7  # of the price of a residual's bit: an anchor serves for longer than a frame


@dataclass(frozen=True, slots=True, eq=False)
class HalfTrained:
    """A later frame some steps into its training.

    Attributes:
        trained: anchors in training, as they are now; living: all that are alive, as they were; every: dead ones too.
        statistics: of the gradients of `trained` so far.
        views: the pictures. drawn: [H,W,3] what was last drawn, by the number of the view.
        masks: [C,H,W] bool, pixels that changed.
        most: anchors that may be added.
    """

    trained: Field
    living: Field
    every: Field
    statistics: GrowthStatistics
    views: Views
    drawn: Mapping[int, Tensor]
    masks: Tensor
    most: int


class LaterGrowth(Protocol):
    """Decides where anchors are added while a later frame trains."""

    @property
    def uses_gradients(self) -> bool:
        """Whether statistics of gradients are kept for it."""

    def new_anchors(self, seen: HalfTrained, generator: torch.Generator) -> dict[str, Tensor]:
        """The seven arrays of the anchors to add, as training begins with them; of no rows for none."""


@dataclass(frozen=True, slots=True)
class ByError:
    """Where the changed pixels' error lies, as long as it is worth an anchor's bits (our default).

    Attributes:
        bit_weight: of a bit, in units of one picture's sum of absolute errors. Under rate control it stays as it is: an
            anchor serves for longer than a burst lasts.
    """

    bit_weight: float

    @property
    def uses_gradients(self) -> bool:
        """As `LaterGrowth.uses_gradients`."""
        return False

    def new_anchors(self, seen: HalfTrained, generator: torch.Generator) -> dict[str, Tensor]:
        """As `LaterGrowth.new_anchors`."""
        price = self.bit_weight * ANCHOR_BITS
        nodes = error_nodes(seen.living, seen.views, seen.drawn, seen.masks, seen.most, price)
        return values_at(seen.living, nodes, generator)


@dataclass(frozen=True, slots=True)
class ByGradient:
    """Where Gaussians in training pull hardest, with the features of their anchors (the rule of Octree-GS).

    Attributes:
        threshold: as `GradientGrowth` has it.
    """

    threshold: float

    @property
    def uses_gradients(self) -> bool:
        """As `LaterGrowth.uses_gradients`."""
        return True

    def new_anchors(self, seen: HalfTrained, generator: torch.Generator) -> dict[str, Tensor]:
        """As `LaterGrowth.new_anchors`."""
        rule, highest = GradientGrowth(self.threshold), seen.every.octree.levels - 1
        new = rule.new_anchors(seen.trained, seen.statistics, highest, seen.most, occupied=seen.every)
        return first_values(seen.trained, new, generator)


LATER_RULES: dict[str, Callable[[PredictConfig], LaterGrowth]] = {
    "error": lambda config: ByError(_ANCHOR_BIT * config.rate_weight),
    "gradient": lambda config: ByGradient(config.growth_threshold),
}


def later_growth(config: PredictConfig) -> LaterGrowth:
    """The rule that a configuration names.

    Raises:
        InputError: no rule has that name.
    """
    if config.growth_rule not in LATER_RULES:
        raise unknown_name("growth rule", config.growth_rule, LATER_RULES)
    return LATER_RULES[config.growth_rule](config)
