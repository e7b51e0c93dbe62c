"""Offsets of a walk's cameras by the sound of their videos."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from statistics import median_low

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.sound.alike import RATE, WAY, heard_offsets, rises
from streamlod.core.calibration.walk import WalkFootage
from streamlod.core.data.video.sound import filmed_sound, sound_channels
from streamlod.core.errors import InputError

_LOG = logging.getLogger(__name__)
REACH_S = 60.0  # that videos may have been begun apart
_LISTENED_S = 240.0
_BY_HAND = 1000  # milliseconds at both ends of a video, in which a hand touches the camera


def walk_offsets(footage: Sequence[WalkFootage]) -> Float64:
    """[C] seconds to add to each camera's clock to get that of one of them, by what both heard; NaN where unknown."""
    return heard_offsets([_rises(each) for each in footage], REACH_S)


def unlike_clocks(footage: Sequence[WalkFootage], heard: Float64) -> Float64:
    """[C] seconds to add to each camera's clock by sound alone; 0 where they are unknown, and for all where the clocks
    agree to half a period, as these may agree exactly.

    Args:
        heard: [C] of `walk_offsets`.
    """
    known = heard[np.isfinite(heard)]
    offsets = np.nan_to_num(heard - median_low(known)) if len(known) else np.zeros(len(heard))
    period = min(each.period for each in footage)
    return np.where((np.abs(offsets) <= period / 2 + WAY).all(), 0.0, offsets)


def _rises(footage: WalkFootage) -> Float64:
    """The `rises` of a camera's video, its ends apart; empty without sound."""
    try:
        if footage.sound is None or sound_channels(footage.sound) is None:
            return np.zeros(0)
        count = round(min(float(footage.times[-1]), _LISTENED_S) * RATE)
        found = rises(np.concatenate(list(filmed_sound(footage.sound, RATE, 0, count))))
    except InputError as error:
        _LOG.warning("%s; its sound is left out", error)
        return np.zeros(0)
    found[:_BY_HAND] = found[-_BY_HAND:] = 0.0
    return found
