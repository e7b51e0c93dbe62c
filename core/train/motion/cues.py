"""Motion cues: rules that say which anchors a frame trains (paper section IV-B), by name.

To add one, write a frozen dataclass with a `partition` method here and name it in `CUES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from streamlod.core.arrays import Bool
from streamlod.core.errors import unknown_name
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.motion.masks import dynamic_anchors
from streamlod.core.train.motion.partition import Observation
from streamlod.core.train.motion.scores import change_scores, error_scores

_HYSTERESIS = 0.5  # an anchor stays dynamic above this share of the entering posterior
_MAX_CHANGED = 0.5  # share of changed pixels above which nothing stands still for the mixture to separate


class MotionCue(Protocol):
    """Decides which anchors a frame trains."""

    @property
    def only_changed_views(self) -> bool:
        """Whether cameras in which no pixel changed are left out of the frame's training."""

    def partition(self, seen: Observation) -> Bool:
        """[N] bool: the anchors to train, the dynamic set."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Gradient of the new pictures' error less that of the reference pictures', on changed pixels only (our default).

    Attributes:
        posterior: of the mixture's dynamic component, from which an anchor is trained.
    """

    posterior: float

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return True

    def partition(self, seen: Observation) -> Bool:
        """As `MotionCue.partition`."""
        if not seen.masks.any():
            return np.zeros(len(seen.field), np.bool_)
        scores = change_scores(seen)
        if seen.masks[seen.views.usable].float().mean() > _MAX_CHANGED:
            return np.asarray(scores > 0)
        return dynamic_anchors(scores, seen.previous, self.posterior, self.posterior * _HYSTERESIS)


@dataclass(frozen=True, slots=True)
class RenderingError:
    """Gradient of the error between a rendering of the keyframe's state and the new pictures (the paper's cue).

    Attributes:
        posterior: of the mixture's dynamic component, from which an anchor is dynamic.
    """

    posterior: float

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return False

    def partition(self, seen: Observation) -> Bool:
        """As `MotionCue.partition`."""
        if not seen.masks.any():  # where no pixel changed, the error is static
            return np.zeros(len(seen.field), np.bool_)
        scores = error_scores(seen.canonical, seen)
        return dynamic_anchors(scores, seen.previous, self.posterior, self.posterior * _HYSTERESIS)


@dataclass(frozen=True, slots=True)
class Everything:
    """Every living anchor is dynamic in every frame, changed or not: a bound for studies."""

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return False

    def partition(self, seen: Observation) -> Bool:
        """As `MotionCue.partition`."""
        return np.asarray(seen.alive.cpu().numpy())


CUES: dict[str, Callable[[PredictConfig], MotionCue]] = {
    "difference": lambda config: Difference(config.posterior),
    "canonical": lambda config: RenderingError(config.posterior),
}


def cue_of(config: PredictConfig) -> MotionCue:
    """The cue that a configuration names.

    Raises:
        InputError: no cue has that name.
    """
    if config.everything:
        return Everything()
    if config.cue not in CUES:
        raise unknown_name("motion cue", config.cue, CUES)
    return CUES[config.cue](config)
