"""How far clocks are apart, by what several microphones heard: a clap, a door, a voice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamlod.core.arrays import Float64, Int16

RATE = 8000  # samples a second that `rises` takes
WAY = 0.010  # seconds that sound takes for three metres, by which microphones differ without a fault
_STEP = 8  # samples: a millisecond
_NEAR = 30  # milliseconds about the best match within which another one is the same
_CLEAR = 2.0  # times as good as any other match, to be no chance


def rises(samples: Int16) -> Float64:
    """[T] how much louder it gets from each millisecond to the next, of samples [N, channels] at `RATE`."""
    mono = samples[: len(samples) // _STEP * _STEP].astype(np.float64).mean(axis=1)
    loud = np.sqrt((mono.reshape(-1, _STEP) ** 2).mean(axis=1))
    return np.asarray(np.maximum(np.diff(loud), 0.0), np.float64)


def heard_later(first: Float64, second: Float64, reach: float) -> float | None:
    """Seconds by which `second` hears later what `first` hears, both from `rises`; None where that is not clear.

    Args:
        reach: seconds either way that are searched.
    """
    before, after = (min(round(reach * RATE / _STEP), len(each) - 1) for each in (first, second))
    if min(before, after) <= _NEAR or not first.any() or not second.any():
        return None
    one, other = (each - each.mean() for each in (first, second))
    length = 1 << int(np.ceil(np.log2(len(one) + len(other))))
    match = np.fft.irfft(np.conj(np.fft.rfft(one, length)) * np.fft.rfft(other, length), length)
    match = np.concatenate([match[-before:], match[: after + 1]])
    best = int(match.argmax())
    elsewhere = np.abs(np.arange(len(match)) - best) > _NEAR
    if match[best] <= _CLEAR * max(float(match[elsewhere].max()), 0.0):
        return None
    return (best - before) * _STEP / RATE


def heard_offsets(rising: Sequence[Float64], reach: float) -> Float64:
    """[C] seconds to add to each clock to get that of the first in the largest group of microphones that heard the
    same; NaN for those outside it, and for all where no two heard the same.

    Args:
        rising: of each, `rises` on its own clock, beginning at 0; empty without sound.
        reach: see `heard_later`.
    """
    left, largest = [number for number, each in enumerate(rising) if each.any()], dict[int, float]()
    while len(left) > len(largest):
        group = {left.pop(0): 0.0}
        for known in (waiting := list(group)):
            for other in list(left):
                if (later := heard_later(rising[known], rising[other], reach)) is not None:
                    group[other] = group[known] - later
                    left.remove(other)
                    waiting.append(other)
        if len(group) > max(1, len(largest)):
            largest = group
    return np.array([largest.get(number, np.nan) for number in range(len(rising))])
