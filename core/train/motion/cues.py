"""Motion cues: rules that say which anchors a frame trains (paper section IV-B), by name.

To add one, write a function of an `Observation` here and name it in `CUES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool
from streamlod.core.errors import unknown_name
from streamlod.core.train.motion.masks import dynamic_anchors
from streamlod.core.train.motion.scores import Observation, change_scores, error_scores

_MAX_CHANGED = 0.5  # share of changed pixels above which nothing stands still for the mixture to separate


@dataclass(frozen=True, slots=True)
class MotionCue:
    """Decides which anchors a frame trains.

    Attributes:
        partition: [N] bool, the anchors to train, the dynamic set, of what is seen and of the posterior of the
            mixture's dynamic component from which an anchor is trained.
        only_changed_views: whether cameras in which no pixel changed are left out of the frame's training.
    """

    partition: Callable[[Observation, float], Bool]
    only_changed_views: bool


def _difference(seen: Observation, posterior: float) -> Bool:
    """By the gradient of the new pictures' error less that of the reference pictures', on changed pixels only."""
    scores = change_scores(seen)
    if seen.masks[seen.views.usable].float().mean() > _MAX_CHANGED:
        return np.asarray(scores > 0)
    return dynamic_anchors(scores, posterior)


def _canonical(seen: Observation, posterior: float) -> Bool:
    """By the gradient of the error between a rendering of the keyframe's state and the new pictures (the paper's)."""
    if not seen.masks.any():  # where no pixel changed, the error is static
        return np.zeros(len(seen.field), np.bool_)
    return dynamic_anchors(error_scores(seen), posterior)


def _everything(seen: Observation, posterior: float) -> Bool:
    """All living anchors, changed or not: a bound for studies."""
    return np.asarray(seen.alive.cpu().numpy())


CUES = {
    "difference": MotionCue(_difference, only_changed_views=True),
    "canonical": MotionCue(_canonical, only_changed_views=False),
    "everything": MotionCue(_everything, only_changed_views=False),
}


def cue_of(name: str) -> MotionCue:
    """The cue of this name.

    Raises:
        InputError: there is none.
    """
    if name not in CUES:
        raise unknown_name("motion cue", name, CUES)
    return CUES[name]
