"""Why cameras cannot be joined: what their tracks show of the board when they should have seen it at one time."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations, product

import numpy as np
from scipy.sparse.csgraph import connected_components

from streamlod.core.arrays import Float64, Int64, nearest_of
from streamlod.core.calibration.track import MIN_CORNERS, Track
from streamlod.core.data.names import spoken
from streamlod.core.errors import InputError

MIN_SHARED = 5  # instants that two cameras need to see together
_SQUARE_PIXELS = 13.0  # width of a square from which most boards are found (`python -m tests.bench.board_bench`)
_SQUARES_A_SECOND = 8.0  # speed of a board from which exposures of 15 ms blur a marker by one of its cells
_SHORTLY_S = 1.0  # before or after another camera sees the board, a camera that sees it then has lost it in between


def apart(tracks: Sequence[Track], offsets: Float64, inside: set[int], usable: int, board: Float64) -> InputError:
    """The error for the cameras that are not `inside` a rig, with what the tracks show as the cause.

    Args:
        offsets: [C] seconds from each camera's clock to the common time.
        usable: most instants at which one inside and one outside saw the board so that their poses agree.
        board: [J,3] corners in metres.
    """
    outside = [number for number in range(len(tracks)) if number not in inside]
    meetings = [_meetings(tracks, offsets, a, b) for a, b in product(sorted(inside), outside)]
    seen = max(both for both, _ in meetings)
    names = [spoken((tracks[number].camera for number in each), 8) for each in (outside, sorted(inside))]
    if usable:
        often = f"at {usable} instants only"
    elif seen:
        often = f"in {seen} picture{'s' if seen > 1 else ''}, none of which can be used"
    else:
        often = "never"
    cause = _bad_sights(tracks, set[tuple[int, int]]().union(*(sights for _, sights in meetings)), board)
    if cause is None and seen >= MIN_SHARED:
        cause = "the poses do not agree: a camera moved, the times are wrong, or the board was far away; film it again"
    return InputError(
        f"camera{'s' if len(outside) > 1 else ''} {names[0]}",
        f"saw the board together with {names[1]} {often}, and {MIN_SHARED} are needed; "
        + (cause or "hold the board where both see it, or film all cameras in one walk"),
    )


def in_turn(tracks: Sequence[Track], offsets: Float64, board: Float64) -> InputError | None:
    """The error for cameras that saw the board in turn, never together, by clocks that are known; None if none did.

    Paths of a board that no two cameras saw together may still lie alike at some wrong offset of the clocks.

    Args:
        offsets: [C] seconds from each camera's clock to the common time, as far as sound tells.
        board: [J,3] corners in metres.
    """
    joined = np.eye(len(tracks), dtype=bool)
    for a, b in combinations(range(len(tracks)), 2):
        joined[a, b] = joined[b, a] = _meetings(tracks, offsets, a, b)[0] >= MIN_SHARED
    count, groups = connected_components(joined)
    if count == 1:
        return None
    largest = int(np.bincount(groups).argmax())
    return apart(tracks, offsets, set(np.flatnonzero(groups == largest).tolist()), 0, board)


def _meetings(tracks: Sequence[Track], offsets: Float64, a: int, b: int) -> tuple[int, set[tuple[int, int]]]:
    """How many pictures at one time show the board to both of two cameras; and (camera, picture) where one saw it too
    badly while the other saw it, or shortly before or after that."""
    both, sights = 0, set[tuple[int, int]]()
    for one, other in ((a, b), (b, a)):
        mine = np.flatnonzero(tracks[one].seen >= MIN_CORNERS)
        times = tracks[one].times[mine] + offsets[one] - offsets[other]
        theirs = np.flatnonzero(tracks[other].seen)
        if not len(theirs):
            continue
        near = theirs[nearest_of(tracks[other].times[theirs], times)]
        away = np.abs(tracks[other].times[near] - times)
        now = away <= tracks[other].period / 2
        both = max(both, int((now & (tracks[other].seen[near] >= MIN_CORNERS)).sum()))
        sights |= {(other, int(row)) for row in near[away <= _SHORTLY_S]}
        sights |= {(one, int(row)) for row in mine[now]}
    return both, sights


def _bad_sights(tracks: Sequence[Track], sights: Collection[tuple[int, int]], board: Float64) -> str | None:
    """One sentence on a camera that mostly saw the board too small, or too fast, in these of its pictures."""
    found = []
    for camera in sorted({camera for camera, _ in sights}):
        rows = np.unique([row for each, row in sights if each == camera])
        if len(rows) < MIN_SHARED:
            continue
        pixels = np.array([_square_pixels(tracks[camera].corners[row], board) for row in rows])
        speed = np.array(list(_speeds(tracks[camera], rows))) / pixels
        small, fast = pixels < _SQUARE_PIXELS, speed > _SQUARES_A_SECOND
        name, width = tracks[camera].camera, float(np.median(pixels))
        if small.mean() > 0.5:
            found.append(
                (float(small.mean()), f"in {name} its squares are {width:.0f} pixels wide then, and {_SQUARE_PIXELS:g} "
                "are needed; come nearer, print the board larger, or film larger pictures")
            )  # fmt: skip
        elif fast.mean() > 0.5:
            often = float(np.median(speed[np.isfinite(speed)])) if np.isfinite(speed).any() else np.inf
            how = "by " + f"{often:.0f} squares a second" if np.isfinite(often) else "so fast that it is lost at once"
            found.append((float(fast.mean()), f"in {name} it moves {how} then, too fast; walk slower, with more light"))
    return max(found)[1] if found else None


def _square_pixels(corners: Float64, board: Float64) -> float:
    """Width of a square in a picture with corners [J,2], in pixels, a mean of across and down."""
    known = np.isfinite(corners[:, 0])
    plane = board[known, :2] - board[known, :2].mean(axis=0)
    scale, _, rank, _ = np.linalg.lstsq(plane, corners[known] - corners[known].mean(axis=0), rcond=None)
    widths = np.linalg.svd(scale, compute_uv=False)[: max(1, int(rank))]  # corners on one line show one width alone
    return float(np.linalg.norm(board[1] - board[0]) * np.prod(widths) ** (1 / len(widths)))


def _speeds(track: Track, rows: Int64) -> Iterator[float]:
    """Pixels a second of the corners in these pictures; infinite where neither neighbour shows them."""
    for row in rows:
        speeds = []
        for beside in (row - 1, row + 1):
            if 0 <= beside < len(track.times):
                moved = np.linalg.norm(track.corners[beside] - track.corners[row], axis=1)
                if np.isfinite(moved).any():
                    speeds.append(float(np.nanmedian(moved)) / abs(float(track.times[beside] - track.times[row])))
        yield min(speeds, default=np.inf)
