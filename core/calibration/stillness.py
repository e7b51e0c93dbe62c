"""A camera that was turned in the midst of a walk: from some instant on, it stands otherwise to all the others.

Bundle adjustment spreads such a turn over lenses and board poses, until no residual is large. So it is looked for
before, in the poses of the board that each camera found by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.errors import InputError

_LEAST = 6  # instants on each side
_DEGREES, _SCATTERS, _SIGMAS = 1.0, 3.0, 10.0  # that a jump has at least: in itself, in scatters, in standard errors
_NEAR = 0.2  # of the walk, within which the jumps of one camera lie: pairs do not see the board all the time


@dataclass(frozen=True, slots=True)
class _Jump:
    """Where one camera's direction as another sees it changes most: the instant, and whether that is no chance."""

    instant: int
    is_real: bool


def check_still(names: Sequence[str], views: Sequence[Float64]) -> None:
    """Raise InputError for a camera that turned beside all others that saw the board with it long enough.

    Args:
        views: for each camera, the board's poses [I,6] in it at the walk's instants, NaN where not seen.
    """
    jumps = {
        (a, b): jump
        for a, b in combinations(range(len(names)), 2)
        if (jump := _jump(rigid.after(views[b], rigid.inverse(views[a])))) is not None
    }
    for number, name in enumerate(names):
        mine = [jump for pair, jump in jumps.items() if number in pair]
        others = [jump for pair, jump in jumps.items() if number not in pair]
        if len(mine) < 2 or not all(jump.is_real for jump in mine) or any(jump.is_real for jump in others):
            continue
        instants = [jump.instant for jump in mine]
        if max(instants) - min(instants) <= _NEAR * len(views[0]):
            part = 100 * float(np.median(instants)) / len(views[0])
            raise InputError(
                f"camera {name}",
                f"was knocked or turned during the walk, after about {part:.0f} % of it; film the walk again and leave "
                "the cameras alone",
            )


def _jump(relative: Float64) -> _Jump | None:
    """The largest change of the poses [I,6] of one camera in another; None where too few are known."""
    instants = np.flatnonzero(np.isfinite(relative[:, 0]))
    if len(instants) < 2 * _LEAST:
        return None
    middle, _ = rigid.median_pose(relative[instants])
    turns = np.degrees(rigid.after(relative[instants], rigid.inverse(middle))[:, :3])
    best, found = 0.0, _Jump(int(instants[0]), False)
    for cut in range(_LEAST, len(turns) - _LEAST + 1):
        degrees, scatter, error = _change(turns[:cut], turns[cut:])
        if degrees / error > best:
            best = degrees / error
            is_real = degrees > max(_DEGREES, _SCATTERS * scatter) and best > _SIGMAS
            found = _Jump(int(instants[cut]), is_real)
    return found


def _change(before: Float64, after: Float64) -> tuple[float, float, float]:
    """(degrees between the medians of two sets of turns [N,3], the larger scatter, standard error)."""
    first, second = np.median(before, axis=0), np.median(after, axis=0)
    scatters = [
        float(np.median(np.linalg.norm(turns - median, axis=1))) for turns, median in ((before, first), (after, second))
    ]
    error = np.hypot(scatters[0] / np.sqrt(len(before)), scatters[1] / np.sqrt(len(after)))
    return float(np.linalg.norm(second - first)), max(scatters), max(0.05, float(error))
