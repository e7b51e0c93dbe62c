"""First time offsets of cameras: the board's speed in space, which all cameras see alike wherever they stand."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.graph import board_poses
from streamlod.core.calibration.track import Track

_MIN_OVERLAP_S = 2.0
_MIN_SAMPLES = 20
_SPAN_S = 0.2  # over which a speed is measured
_LASTING_S = 0.4  # seconds after which a walking person's speed is a new one
_CERTAIN = 5.0  # of the score of two speeds that are the same; the best of many by chance has about 4
_BETTER = 1.3  # times the score of no offset at all


def first_offsets(tracks: Sequence[Track], lenses: Float64, board: Float64, centre: Float64) -> Float64:
    """[C] seconds that lead from each camera's clock to that of one of them; 0 where speeds do not tell.

    Pairs are joined from the most certain one on.

    Args:
        lenses: [C,9]. board: [J,3] corners. centre: [3] of the board, in metres.
    """
    period = min(track.period for track in tracks)
    speeds = [_speeds(track, lens, board, centre, period) for track, lens in zip(tracks, lenses, strict=True)]
    edges = sorted(((*_lag(*speeds[a], *speeds[b], period), a, b) for a, b in _pairs(len(tracks))), reverse=True)
    offsets: dict[int, float] = {0: 0.0}
    while len(offsets) < len(tracks):
        way = next(((lag, a, b) for _, lag, a, b in edges if (a in offsets) != (b in offsets)), None)
        if way is None:
            break
        lag, a, b = way
        if a in offsets:
            offsets[b] = offsets[a] + lag
        else:
            offsets[a] = offsets[b] - lag
    return np.array([offsets.get(number, 0.0) for number in range(len(tracks))])


def _pairs(count: int) -> list[tuple[int, int]]:
    return list(combinations(range(count), 2))


def _speeds(track: Track, lens: Float64, board: Float64, centre: Float64, period: float) -> tuple[float, Float64]:
    """(first time, [2,S] logarithms of metres and of radians a second on a grid of `period`), NaN where not known."""
    poses = board_poses(track.corners, lens, board)
    places = rigid.after(poses, np.concatenate([np.zeros(3), centre]))[:, 3:]
    apart = max(2, round(_SPAN_S / track.period))  # pictures: those of a fast camera lie too near to tell a speed
    steps = track.times[apart:] - track.times[:-apart]
    metres = np.linalg.norm(places[apart:] - places[:-apart], axis=1) / steps
    radians = np.radians(rigid.angles(poses[:-apart], poses[apart:])) / steps
    known = (steps < (apart + 3) * track.period) & np.isfinite(metres)
    count = int((track.times[-1] - track.times[0]) / period) + 1
    grid = track.times[0] + period * np.arange(count)
    found = np.full((2, count), np.nan)
    if known.sum() >= _MIN_SAMPLES:
        times = ((track.times[apart:] + track.times[:-apart]) / 2)[known]
        place = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
        inside = np.maximum(np.abs(grid - times[place - 1]), np.abs(times[place] - grid)) < 2.5 * track.period
        for row, values in enumerate((metres[known] + 0.02, radians[known] + 0.05)):  # of a still board: noise
            found[row] = np.where(inside, np.interp(grid, times, np.log(values)), np.nan)
    return float(track.times[0]), found


def _lag(first_a: float, a: Float64, first_b: float, b: Float64, period: float) -> tuple[float, float]:
    """(score, seconds to add to the clock of b) at which the speeds of two cameras agree best.

    The score is Fisher's z of the correlation, in standard deviations of chance.
    """
    least = max(_MIN_SAMPLES, int(_MIN_OVERLAP_S / period))
    shifts = np.arange(-b.shape[1] + least, a.shape[1] - least + 1)
    scores = np.array([_score(a, b, int(shift), least) for shift in shifts]) if len(shifts) else np.zeros(0)
    scores *= np.sqrt(min(1.0, period / _LASTING_S))
    if not len(scores) or scores.max() <= _CERTAIN:
        return 0.0, 0.0
    lags = shifts * period + first_a - first_b
    best = int(scores.argmax())
    still = int(np.abs(lags).argmin())
    if abs(lags[still]) <= period and scores[best] < _BETTER * scores[still]:
        return float(scores[still]), 0.0
    return float(scores[best]), float(lags[best])


def _score(a: Float64, b: Float64, shift: int, least: int) -> float:
    """The score of b[t] beside a[t + shift]."""
    begin, end = max(0, shift), min(a.shape[1], b.shape[1] + shift)
    one, other = a[:, begin:end], b[:, begin - shift : end - shift]
    known = np.isfinite(one[0]) & np.isfinite(other[0])
    if known.sum() < least:
        return 0.0
    one, other = one[:, known], other[:, known]
    one, other = one - one.mean(axis=1, keepdims=True), other - other.mean(axis=1, keepdims=True)
    power = np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))
    correlation = float(((one * other).sum(axis=1) / np.maximum(power, 1e-12)).mean())
    return float(np.arctanh(np.clip(correlation, 0, 0.999)) * np.sqrt(known.sum()))
