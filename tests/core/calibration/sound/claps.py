"""What microphones hear of one room: claps with an echo, noise of their own, and hands that touch them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from streamlod.core.calibration.sound.alike import RATE

CLAPS = (4.1, 6.45, 7.2)  # seconds


def claps(
    begin: float,
    seconds: float,
    seed: int,
    *,
    gain: float = 1.0,
    noise: float = 60.0,
    touched: float = 0.0,
    at: Sequence[float] = CLAPS,
) -> NDArray[np.int16]:
    """[N,1] samples at `RATE` of a microphone that begins to hear at `begin`, of claps `at` these seconds.

    Args:
        gain: of the claps. noise: its own, of 32768. touched: how loud the hand is that starts and stops it.
    """
    own = np.random.default_rng(1000 + seed)
    sound = own.normal(0, noise, round(seconds * RATE))
    for clap in at:
        for echo, share in ((0.0, 1.0), (0.013 + 0.004 * seed, 0.5)):
            _add(sound, clap - begin + echo, 9000 * gain * share * _burst(round(1000 * clap)))
    for hand in (0.3, seconds - 0.4):
        _add(sound, hand, touched * _burst(99 + seed))
    return np.clip(sound, -32768, 32767).astype(np.int16)[:, None]


def _burst(seed: int) -> NDArray[np.float64]:
    fading = np.exp(-np.arange(RATE // 2) / (0.02 * RATE))
    return np.asarray(np.random.default_rng(seed).normal(0, 1, RATE // 2) * fading, np.float64)


def _add(sound: NDArray[np.float64], at: float, wave: NDArray[np.float64]) -> None:
    first = round(at * RATE)
    if first >= 0:
        part = sound[first : first + len(wave)]
        part += wave[: len(part)]
