"""Motion cues: rules that say which anchors a frame trains (paper section IV-B), by name.

To add one, write a frozen dataclass with a `partition` method here and name it in `CUES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.errors import unknown_name
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.motion.masks import dynamic_anchors, moved_pixels
from streamlod.core.train.motion.partition import Observation, Partition, all_static
from streamlod.core.train.motion.scores import change_scores, error_scores, shown_shares
from streamlod.core.train.pictures.parallel import map_pairs

_HYSTERESIS = 0.5  # an anchor stays dynamic above this share of the entering posterior
_SHARE_POWER = 2  # of an anchor's share of moved pixels, in its score of motion
_SHOWS = 0.1  # share of moved pixels from which an anchor that moves steadily is taken to move
_MAX_CHANGED = 0.5  # share of changed pixels above which nothing stands still for the mixture to separate


class MotionCue(Protocol):
    """Decides which anchors a frame trains."""

    @property
    def only_changed_views(self) -> bool:
        """Whether cameras in which no pixel changed are left out of the frame's training."""

    def partition(self, seen: Observation) -> Partition:
        """The partition of the anchors that `seen` shows."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Gradient of the new pictures' error less that of the reference pictures', on changed pixels only (our default).

    Attributes:
        posterior: of the mixture's dynamic component, from which an anchor is taken to move.
        changed_posterior: the same, from which it is trained because it looks different.
        noise_floor: smallest change of grey value that counts, in units of [0, 1].
    """

    posterior: float
    changed_posterior: float
    noise_floor: float

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return True

    def partition(self, seen: Observation) -> Partition:
        """As `MotionCue.partition`."""
        if not seen.masks.any():
            return all_static(len(seen.field))
        rows, lowest = torch.nonzero(seen.alive)[:, 0], self.changed_posterior
        scores = change_scores(seen, rows, rows[:0], seen.masks)
        changed = dynamic_anchors(scores, seen.previous.trained, lowest, lowest * _HYSTERESIS)
        if seen.masks[seen.views.usable].float().mean() > _MAX_CHANGED:
            changed = scores > 0
        if not changed.any():
            return all_static(len(seen.field))
        return Partition(self._moving(seen, changed) if seen.label else None, changed)

    def _moving(self, seen: Observation, changed: Bool) -> Bool:
        """[N] which of the anchors `changed` [N] move.

        They explain changes that no light does and show little else, or show some of them and move steadily.
        """
        moved = self._moved_pixels(seen)
        chosen = torch.from_numpy(changed).to(seen.alive.device)
        rows, others = torch.nonzero(chosen)[:, 0], torch.nonzero(seen.alive & ~chosen)[:, 0]
        scores = change_scores(seen, rows, others, moved)
        shares = shown_shares(seen, rows, others, moved)
        previous = np.zeros(len(seen.field), np.bool_) if seen.previous.dynamic is None else seen.previous.dynamic
        explained = scores * shares**_SHARE_POWER
        moving = dynamic_anchors(explained, previous, self.posterior, self.posterior * _HYSTERESIS)
        return moving | (changed & seen.steady & (shares >= _SHOWS))

    def _moved_pixels(self, seen: Observation) -> Tensor:
        """[C,H,W] bool: changed pixels that no change of light explains."""
        moved = torch.zeros_like(seen.masks)
        changed = [number for number in seen.views.usable if seen.masks[number].any()]
        pairs = [(seen.filmed[number].cpu().numpy(), seen.views.targets[number].cpu().numpy()) for number in changed]
        found = map_pairs(partial(moved_pixels, floor=self.noise_floor), pairs)
        for number, mask in zip(changed, found, strict=True):
            moved[number] = torch.from_numpy(mask).to(moved.device)
        return moved & seen.masks


@dataclass(frozen=True, slots=True)
class RenderingError:
    """Gradient of the error between a rendering of the keyframe's state and the new pictures (the paper's cue).

    All that is trained is taken to move.

    Attributes:
        posterior: of the mixture's dynamic component, from which an anchor is dynamic.
    """

    posterior: float

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return False

    def partition(self, seen: Observation) -> Partition:
        """As `MotionCue.partition`."""
        if not seen.masks.any():  # where no pixel changed, the error is static
            return all_static(len(seen.field))
        scores = error_scores(seen.canonical, seen)
        dynamic = dynamic_anchors(scores, seen.previous.trained, self.posterior, self.posterior * _HYSTERESIS)
        return Partition(dynamic, dynamic)


@dataclass(frozen=True, slots=True)
class Everything:
    """Every living anchor is dynamic in every frame, changed or not: a bound for studies."""

    @property
    def only_changed_views(self) -> bool:
        """As `MotionCue.only_changed_views`."""
        return False

    def partition(self, seen: Observation) -> Partition:
        """As `MotionCue.partition`."""
        alive = np.asarray(seen.alive.cpu().numpy())
        return Partition(alive, alive)


CUES: dict[str, Callable[[PredictConfig], MotionCue]] = {
    "difference": lambda config: Difference(config.posterior, config.changed_posterior, config.noise_floor),
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
