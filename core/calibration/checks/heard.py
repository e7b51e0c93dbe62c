"""How far cameras are apart in time, by what several of them heard: a clap, a door, a voice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from streamlod.core.arrays import Float64, Int16
from streamlod.core.calibration.checks.finding import RigFinding, fact, weak
from streamlod.core.data.names import spoken

RATE = 8000  # samples a second that `rises` takes
_STEP = 8  # samples: a millisecond
_REACH = 800  # milliseconds either way that are searched
_NEAR = 30  # milliseconds about the best match within which another one is the same
_CLEAR = 2.0  # times as good as any other match, to be no chance
_WAY = 0.010  # seconds that sound takes for three metres, by which microphones differ without a fault


def rises(samples: Int16) -> Float64:
    """[T] how much louder it gets from each millisecond to the next, of samples [N, channels] at `RATE`."""
    mono = samples[: len(samples) // _STEP * _STEP].astype(np.float64).mean(axis=1)
    loud = np.sqrt((mono.reshape(-1, _STEP) ** 2).mean(axis=1))
    return np.asarray(np.maximum(np.diff(loud), 0.0), np.float64)


def heard_later(first: Float64, second: Float64) -> float | None:
    """Seconds by which `second` hears later what `first` hears, both from `rises`; None where that is not clear."""
    if min(len(first), len(second)) <= 2 * _REACH or not first.any() or not second.any():
        return None
    one, other = (each - each.mean() for each in (first, second))
    length = 1 << int(np.ceil(np.log2(len(one) + len(other))))
    match = np.fft.irfft(np.conj(np.fft.rfft(one, length)) * np.fft.rfft(other, length), length)
    match = np.concatenate([match[-_REACH:], match[: _REACH + 1]])
    best = int(match.argmax())
    elsewhere = np.abs(np.arange(len(match)) - best) > _NEAR
    if match[best] <= _CLEAR * max(float(match[elsewhere].max()), 0.0):
        return None
    return (best - _REACH) * _STEP / RATE


def judged(rising: Mapping[str, Float64], fps: float) -> Iterator[RigFinding]:
    """Findings about cameras that hear at another time than most; none where fewer than two heard the same.

    Args:
        rising: by camera, `rises` of its sound on the clock by which pictures are paired.
        fps: pictures a second.
    """
    names = list(rising)
    late = {name: heard_later(rising[names[0]], rising[name]) for name in names[1:]}
    known = {names[0]: 0.0} | {name: each for name, each in late.items() if each is not None} if names else {}
    if len(known) < 2:
        return
    middle = float(np.median(list(known.values())))
    off = {name: each - middle for name, each in known.items()}
    for name, seconds in off.items():
        if abs(seconds) > 0.5 / fps + _WAY:
            yield weak(
                f"{name} hears the same {1000 * abs(seconds):.0f} ms {'later' if seconds > 0 else 'earlier'} than most "
                f"cameras, so its pictures are {abs(seconds) * fps:.1f} frames off: walk the board again"
            )
    yield fact(_summary(list(off), max(abs(each) for each in off.values()), fps))


def _summary(names: Sequence[str], most: float, fps: float) -> str:
    return (
        f"by what {spoken(names)} heard, their times agree to {1000 * most:.0f} ms, {most * fps:.1f} frames; "
        "sound takes 3 ms a metre"
    )
