"""The way to a version of a file at the fewest bytes. FORMAT.md section 15."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from streamlod.codec.container.layout import Entry
from streamlod.codec.packet.packet import PacketKind


@dataclass(frozen=True, slots=True)
class _Step:
    """Packets that together lead all levels from one version to another.

    Attributes:
        size_bytes: length of all of them.
        numbers: their entries, in the file's order.
        level_mask: levels that they speak for.
    """

    from_version: int
    to_version: int
    size_bytes: int
    numbers: tuple[int, ...]
    level_mask: int


def way(entries: Sequence[Entry], version: int) -> tuple[int, ...] | None:
    """Numbers of the packets that lead from nothing to `version`, in the order to decode them; None without any."""
    keys = [n for n, e in enumerate(entries) if e.kind is PacketKind.KEY and e.to_version <= version]
    keyframe = max((entries[n].keyframe for n in keys), default=-1)
    keys = [n for n in keys if entries[n].keyframe == keyframe]
    mask = 0
    for n in keys:
        mask |= entries[n].level_mask
    best: dict[int, tuple[int, _Step | None]] = {keyframe: (0, None)}  # bytes to a version, and the last step there
    for step in sorted(_steps(entries, keyframe, mask), key=lambda step: step.to_version):
        if step.from_version in best:
            size_bytes = best[step.from_version][0] + step.size_bytes
            if step.to_version not in best or size_bytes < best[step.to_version][0]:
                best[step.to_version] = (size_bytes, step)
    if not keys or version not in best:
        return None
    steps: list[_Step] = []
    while (last := best[version][1]) is not None:
        steps.append(last)
        version = last.from_version
    return (*keys, *(number for step in reversed(steps) for number in step.numbers))


def _steps(entries: Sequence[Entry], keyframe: int, mask: int) -> list[_Step]:
    """The steps under a keyframe: single packets for all levels of `mask`, and packets for some of them together."""
    whole: list[_Step] = []
    partial: dict[tuple[int, int], _Step] = {}
    for number, e in enumerate(entries):
        if e.kind is PacketKind.KEY or e.keyframe != keyframe or e.from_version >= e.to_version:
            continue
        start, end = e.from_version, e.to_version
        if e.level_mask & mask == mask:
            whole.append(_Step(start, end, e.size_bytes, (number,), mask))
            continue
        before = partial.get((start, end), _Step(start, end, 0, (), 0))
        if e.level_mask & mask & ~before.level_mask:  # it brings a level
            levels = before.level_mask | e.level_mask
            numbers = (*before.numbers, number)
            partial[start, end] = _Step(start, end, before.size_bytes + e.size_bytes, numbers, levels)
    return whole + [step for step in partial.values() if step.level_mask & mask == mask]
