"""The instants of a walk that the adjustment uses: few, and yet all parts of all pictures and all pairs of cameras."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from itertools import combinations

import numpy as np

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.track import MIN_CORNERS, SPAN_S, Track

MAX_INSTANTS = 400
ACROSS, DOWN = 6, 4  # cells of a picture
_ENOUGH = 30  # times that a cell or a pair of cameras is wanted


def cell_numbers(points: Float64, size: tuple[int, int]) -> tuple[Int64, Int64]:
    """[N] columns and [N] rows of the cells of a picture of `size` in which points [N,2] lie."""
    across = np.clip(points[:, 0] / size[0] * ACROSS, 0, ACROSS - 1).astype(int)
    return across, np.clip(points[:, 1] / size[1] * DOWN, 0, DOWN - 1).astype(int)


def cells_of(corners: Float64, size: tuple[int, int]) -> frozenset[Hashable]:
    """Cells of a picture of `size` that corners [J,2] lie in, and how large and how turned the board is seen."""
    known = corners[np.isfinite(corners[:, 0])]
    if not len(known):
        return frozenset()
    across, down = cell_numbers(known, size)
    extent = np.ptp(known, axis=0) / max(size)
    shape = ("shape", round(float(extent[0]) * 8), round(float(extent[1]) * 8))
    return frozenset({*zip(across.tolist(), down.tolist(), strict=True), shape})


def covering(wishes: Sequence[Iterable[Hashable]], at_most: int) -> Int64:
    """Ascending numbers of at most so many items that together fulfil each wish often enough, rarest first.

    Args:
        wishes: what each item fulfils.
    """
    sets = [frozenset(wish) for wish in wishes]
    counts: Counter[Hashable] = Counter()

    def gain(item: int) -> float:
        return sum(1 / (1 + counts[wish]) for wish in sets[item] if counts[wish] < _ENOUGH)

    heap = [(-gain(item), item) for item in range(len(sets))]
    heapq.heapify(heap)
    chosen: list[int] = []
    while heap and len(chosen) < at_most:
        _, item = heapq.heappop(heap)
        now = gain(item)  # gains only fall: one that is still the largest is the largest
        if now <= 0:
            continue
        if heap and now < -heap[0][0]:
            heapq.heappush(heap, (-now, item))
            continue
        chosen.append(item)
        counts.update(sets[item])
    return np.array(sorted(chosen), np.int64)


def candidates(tracks: Sequence[Track], offsets: Float64) -> Float64:
    """[I] common times, ascending: those of pictures with the board.

    None is nearer to another than half a period, or than a thirtieth of a second of slow cameras: between their
    pictures it is hardly known where the board was, and so each picture counts at its own time, too.
    """
    apart = min(SPAN_S, *(track.period for track in tracks)) / 2
    found = np.zeros(0)
    for track, offset in zip(tracks, offsets, strict=True):
        times = track.times[track.seen >= MIN_CORNERS] + offset
        if len(found):
            place = np.searchsorted(found, times)
            gap = np.minimum(
                np.abs(found[np.clip(place, 0, len(found) - 1)] - times),
                np.abs(times - found[np.maximum(place - 1, 0)]),
            )
            times = times[gap > apart]
        found = np.sort(np.concatenate([found, times]))
    return found


def independent(tracks: Sequence[Track], times: Float64) -> Int64:
    """Numbers of the most instants among `times` [I], ascending, that are half a period apart: those nearer together
    rest on the same pictures."""
    apart, last, found = min(track.period for track in tracks) / 2, -np.inf, list[int]()
    for number, time in enumerate(times):
        if time - last > apart:
            found.append(number)
            last = float(time)
    return np.array(found, np.int64)


def chosen_instants(tracks: Sequence[Track], offsets: Float64) -> Float64:
    """[I] common times, ascending, at which the board is used.

    Args:
        offsets: [C] seconds that lead from each camera's clock to the common time.
    """
    times = candidates(tracks, offsets)
    wishes: list[set[Hashable]] = [set() for _ in times]
    sees = np.zeros((len(tracks), len(times)), bool)
    for number, (track, offset) in enumerate(zip(tracks, offsets, strict=True)):
        corners = track.near(times - offset).at(times - offset)
        sees[number] = np.isfinite(corners[..., 0]).sum(axis=1) >= MIN_CORNERS
        for instant in np.flatnonzero(sees[number]):
            wishes[instant] |= {(number, cell) for cell in cells_of(corners[instant], track.size)}
    for number in range(len(times)):
        together = np.flatnonzero(sees[:, number])
        if len(together) > 1:  # a board that one camera sees alone says something of its lens only
            wishes[number] |= {("pair", *pair, weight) for pair in combinations(together, 2) for weight in range(4)}
    return times[covering(wishes, MAX_INSTANTS)]
