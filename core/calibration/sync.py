"""First time offsets of cameras: the board's path in space, which all cameras see alike wherever they stand.

For each offset of two clocks, one camera's path is turned and moved onto the other's (Kabsch, A solution for the best
rotation to relate two sets of vectors, 1976). They lie closest at the true one. What cameras heard says where to look
first, and stands in where paths do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Bool, Float64, Int64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.graph import board_poses
from streamlod.core.calibration.track import Track

_MIN_OVERLAP_S = 2.0
_MIN_SAMPLES = 12
_STEP_S = 0.08  # between offsets that are tried first, in which a walking person comes a few centimetres far
_FINE_S = 0.01
_LASTING_S = 0.4  # seconds after which a walking person is elsewhere
_MAX_SAMPLES = 300  # of a path
_GAP = 1.6  # periods: pictures that are farther apart leave open where the board was between them
_ROUNDS = 3  # of an alignment, in which what lies far off counts less and less
_NEAR_S = 1.0  # clocks so near to each other are tried first
_SURELY, _FAR_SCORE = 1.8, 6.0  # by what others must agree to be taken: chance has 1.2, and more in few seconds alone
_CERTAIN = 4.0  # least score of any
_HEARD, _GUESSED = 1.0, 0.5  # scores of an offset by sound alone, and by a board held still
_ALIKE = 0.95  # of how close paths lie, which a walking person loses within `_STEP_S`


@dataclass(frozen=True, slots=True, eq=False)
class _Path:
    """Where a camera saw the board's centre: times [K] by its clock, and places [K,3] in its axes, in metres."""

    times: Float64
    places: Float64
    period: float

    def at(self, times: Float64) -> Float64:
        """[N,3] places at `times` [N]; NaN where no pictures are near."""
        after = np.clip(np.searchsorted(self.times, times), 1, len(self.times) - 1)
        gap = self.times[after] - self.times[after - 1]
        part = (times - self.times[after - 1]) / gap
        found = self.places[after - 1] + part[:, None] * (self.places[after] - self.places[after - 1])
        found[(gap > _GAP * self.period) | (part < 0) | (part > 1)] = np.nan
        return found


@dataclass(frozen=True, slots=True, eq=False)
class FirstOffsets:
    """Offsets of clocks before adjustment.

    Attributes:
        seconds: [C] to add to each camera's clock to get that of one of them; arbitrary where nothing determines it.
        anchors: [C] the camera to whose clock each camera's offset is known by the path of a moving board.
        heard: [C] whether the offset of a camera that is such an anchor is known by sound.
    """

    seconds: Float64
    anchors: Int64
    heard: Bool

    def by_sound(self, root: int) -> Bool:
        """[C] whether a camera's offset to `root` rests on sound."""
        known = self.heard[self.anchors] & self.heard[self.anchors[root]]
        return np.asarray((self.anchors != self.anchors[root]) & known, np.bool_)

    def guessed(self, root: int) -> Bool:
        """[C] whether a camera's offset to `root` rests on a board held still, which lies alike at other offsets."""
        return np.asarray((self.anchors != self.anchors[root]) & ~self.by_sound(root), np.bool_)

    def held(self, root: int) -> Bool:
        """[C] whether a camera's clock is to stay as sound has it: a board held still would add nothing but noise."""
        return np.asarray(self.by_sound(root) & (self.anchors == np.arange(len(self.anchors))), np.bool_)


def first_offsets(
    tracks: Sequence[Track], lenses: Float64, board: Float64, centre: Float64, heard: Float64 | None = None
) -> FirstOffsets:
    """How far the cameras' clocks are apart.

    Pairs are joined from the most certain one on.

    Args:
        lenses: [C,9]. board: [J,3] corners. centre: [3] of the board, in metres.
        heard: [C] such seconds by sound, NaN where it does not determine them; None without sound.
    """
    paths = [_path(track, lens, board, centre) for track, lens in zip(tracks, lenses, strict=True)]
    by_sound = np.full(len(tracks), np.nan) if heard is None else heard
    pairs = combinations(range(len(tracks)), 2)
    edges = sorted(
        ((*_lag(paths[a], paths[b], float(by_sound[b] - by_sound[a])), a, b) for a, b in pairs), reverse=True
    )
    seconds, anchors, by_ear = {0: 0.0}, {0: 0}, {0: True}
    while len(seconds) < len(tracks):
        score, lag, a, b = next(edge for edge in edges if (edge[2] in seconds) != (edge[3] in seconds))
        known, new, lag = (a, b, lag) if a in seconds else (b, a, -lag)
        seconds[new] = seconds[known] + lag
        anchors[new] = new if score in (_HEARD, _GUESSED) else anchors[known]
        by_ear[new] = score == _HEARD
    order = range(len(tracks))
    return FirstOffsets(*(np.array([each[number] for number in order]) for each in (seconds, anchors, by_ear)))


def _path(track: Track, lens: Float64, board: Float64, centre: Float64) -> _Path:
    poses = board_poses(track.corners, lens, board)
    known = np.isfinite(poses[:, 0])
    places = rigid.after(poses[known], np.concatenate([np.zeros(3), centre]))[:, 3:]
    return _Path(track.times[known], places, track.period)


def _lag(a: _Path, b: _Path, heard: float) -> tuple[float, float]:
    """(score, seconds to add to the clock of b) at which two paths lie closest.

    Args:
        heard: these seconds by sound, or NaN.
    """
    is_heard = bool(np.isfinite(heard))
    otherwise = (_HEARD, heard) if is_heard else (0.0, 0.0)
    if min(len(a.times), len(b.times)) < _MIN_SAMPLES:
        return otherwise
    some = slice(None, None, -(-len(a.times) // _MAX_SAMPLES))
    a = _Path(a.times[some], a.places[some], a.period)
    near = np.arange(-_NEAR_S, _NEAR_S + _STEP_S, _STEP_S)
    best = max(_score(a, b, lag, 1) for lag in (np.concatenate([near, heard + near]) if is_heard else near))
    if best.closer < _SURELY:
        first, last = a.times[0] - b.times[-1] + _MIN_OVERLAP_S, a.times[-1] - b.times[0] - _MIN_OVERLAP_S
        far = [_score(a, b, lag, 1) for lag in np.arange(np.ceil(first / _STEP_S), last / _STEP_S) * _STEP_S]
        best = max((each for each in far if each.value > _FAR_SCORE and each.closer > _SURELY), default=best)
    found = max(_score(a, b, lag, _ROUNDS) for lag in best.lag + np.arange(-_STEP_S, _STEP_S, _FINE_S))
    middle = heard if is_heard else found.lag
    about = [_score(a, b, middle + step, _ROUNDS).closer for step in (-_STEP_S, _STEP_S)]
    if min(about) > _ALIKE * found.closer > 0:  # a board held still lies as close a little before and after
        return otherwise if is_heard else (_GUESSED, found.lag)
    return (found.value, found.lag) if found.value > _CERTAIN else otherwise


@dataclass(frozen=True, slots=True, order=True)
class _Score:
    """How well two paths agree at a `lag` in seconds: `closer` by what they lie `_alike`, `value` also by how long."""

    value: float
    closer: float
    lag: float


def _score(a: _Path, b: _Path, lag: float, rounds: int) -> _Score:
    other = b.at(a.times - lag)
    known = np.isfinite(other[:, 0])
    seconds = float(known.sum()) * min(_LASTING_S, float(np.median(np.diff(a.times))))
    if known.sum() < _MIN_SAMPLES or seconds < _MIN_OVERLAP_S:
        return _Score(0.0, 0.0, float(lag))
    closer = _alike(a.places[known], other[known], rounds)
    return _Score(closer * float(np.sqrt(seconds / _LASTING_S)), closer, float(lag))


def _alike(one: Float64, other: Float64, rounds: int) -> float:
    """How many times closer than their own extent two paths [N,3] lie, a logarithm."""
    weights = np.ones((len(one), 1))
    for _ in range(rounds):
        a, b = (each - (weights * each).sum(axis=0) / weights.sum() for each in (one, other))
        left, _, right = np.linalg.svd((weights * b).T @ a)
        turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
        away = np.linalg.norm(a - b @ turn, axis=1, keepdims=True)
        typical = max(1e-4, float(np.median(away)))
        weights = 1 / (1 + (away / (2 * typical)) ** 2)
    return float(np.log(max(1e-4, float(np.median(np.linalg.norm(a, axis=1)))) / typical))
