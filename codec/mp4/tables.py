"""Where samples of tracks lie, as tables of a file or its fragments say. ISO/IEC 14496-12:2022, sections 8.6 to 8.8.

Tables come from outside. A count that has no bytes of its own behind it, as where all samples have one size, is bounded
by the caller: a few bytes can name millions of samples.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from streamlod.codec.mp4.box import boxes, child, refused, take, version_and_flags
from streamlod.core.arrays import Int64

MAX_SAMPLES = 1 << 22  # of a file, all tracks together: a day and a half at 30 frames a second
_USUAL_SAMPLES = 1 << 16  # that a file may name although it is too short for them: it may have been cut
_WORD, _RUN, _LONG = struct.Struct(">I"), struct.Struct(">II"), struct.Struct(">Q")
_BASE_OFFSET, _DESCRIPTION, _DURATION, _SIZE, _FLAGS = 1, 2, 8, 16, 32  # fields of tfhd
_RUN_OFFSET, _RUN_FIRST_FLAGS = 1, 4
_RUN_COLUMNS = (0x100, 0x200, 0x400, 0x800)  # duration, size, flags, offset of composition


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Samples that follow one another in a track.

    Attributes:
        track: its number.
        offsets, sizes: where they lie in the file, bytes [N].
        times: at which they are decoded, in units of the track [N].
    """

    track: int
    offsets: Int64
    sizes: Int64
    times: Int64


@dataclass(frozen=True, slots=True)
class Defaults:
    """Lengths of samples of a track whose fragments do not say them (box trex)."""

    duration: int = 0
    size: int = 0


def most_samples(file_size: int) -> int:
    """Samples that a file of `file_size` bytes may name: about as many as it has bytes, for each takes one or more."""
    return min(MAX_SAMPLES, max(_USUAL_SAMPLES, file_size))


def table_run(track: int, table: memoryview, most: int) -> Run:
    """The samples that the sample table of a track (box stbl) names, `most` at most.

    Raises:
        BitstreamError: `bad_file`, tables that contradict each other or are too long.
    """
    sizes = _sizes(child(table, b"stsz"), most)
    times = _cumulated(_expanded(child(table, b"stts"), len(sizes)))
    return Run(track, _offsets(table, sizes), sizes, times)


def fragment_runs(moof: memoryview, moof_at: int, defaults: dict[int, Defaults], most: int) -> Iterator[Run]:
    """The samples that a fragment (box moof), which begins at byte `moof_at` of the file, names, `most` at most.

    Raises:
        BitstreamError: `bad_file`, it cannot be understood.
    """
    for traf in boxes(moof):
        if traf.kind != b"traf":
            continue
        _, flags, body = version_and_flags(child(traf.body, b"tfhd"))
        (track,), body = take(_WORD, body)
        base, known = moof_at, defaults.get(track, Defaults())
        if flags & _BASE_OFFSET:
            (base,), body = take(_LONG, body)
        found: dict[int, int] = {}
        for field in (_DESCRIPTION, _DURATION, _SIZE, _FLAGS):
            if flags & field:
                (found[field],), body = take(_WORD, body)
        known = Defaults(found.get(_DURATION, known.duration), found.get(_SIZE, known.size))
        for run in _runs(track, traf.body, base, known, most):
            most -= len(run.sizes)
            yield run


def _runs(track: int, traf: memoryview, base: int, known: Defaults, most: int) -> Iterator[Run]:
    time, at = _decode_time(traf), base
    for each in boxes(traf):
        if each.kind != b"trun":
            continue
        _, flags, body = version_and_flags(each.body)
        (count,), body = take(_WORD, body)
        if flags & _RUN_OFFSET:
            (word,), body = take(_WORD, body)
            at = base + (word - (1 << 32) if word >> 31 else word)
        if flags & _RUN_FIRST_FLAGS:
            _, body = take(_WORD, body)
        columns = [bit for bit in _RUN_COLUMNS if flags & bit]
        _check_count(count, most)
        most -= count
        rows = _words(body, count * len(columns)).reshape(count, len(columns))
        durations, sizes = (
            rows[:, columns.index(bit)] if bit in columns else np.full(count, default, np.int64)
            for bit, default in ((0x100, known.duration), (0x200, known.size))
        )
        yield Run(track, at + _cumulated(sizes), sizes, time + _cumulated(durations))
        time, at = time + int(durations.sum()), at + int(sizes.sum())


def _decode_time(traf: memoryview) -> int:
    version, _, body = version_and_flags(child(traf, b"tfdt"))
    (time,), _ = take(_LONG if version else _WORD, body)
    if time >= 1 << 62:
        raise refused(f"a decode time of {time} is out of reach")
    return time


def _sizes(stsz: memoryview, most: int) -> Int64:
    """The length of each sample."""
    _, _, body = version_and_flags(stsz)
    (size, count), body = take(_RUN, body)
    _check_count(count, most)
    return np.full(count, size, np.int64) if size else _words(body, count)


def _offsets(table: memoryview, sizes: Int64) -> Int64:
    """Where each sample begins: samples lie one after the other in chunks, whose places are known."""
    kinds = {each.kind: each.body for each in boxes(table)}
    long = b"co64" in kinds
    _, _, body = version_and_flags(kinds[b"co64"] if long else child(table, b"stco"))
    (count,), body = take(_WORD, body)
    whole = long and len(body) >= 8 * count
    chunks = np.frombuffer(body, ">u8", count).astype(np.int64) if whole else _words(body, count)
    in_chunks = _samples_in_chunks(child(table, b"stsc"), count)
    if int(in_chunks.sum()) != len(sizes):
        raise refused(f"chunks of {int(in_chunks.sum())} samples are said to hold {len(sizes)}")
    firsts = _cumulated(in_chunks)
    starts = _cumulated(sizes)
    within = starts - np.repeat(starts[np.minimum(firsts, max(len(sizes) - 1, 0))] if len(sizes) else firsts, in_chunks)
    return np.repeat(chunks, in_chunks) + within


def _samples_in_chunks(stsc: memoryview, chunks: int) -> Int64:
    """How many samples each chunk holds."""
    _, _, body = version_and_flags(stsc)
    (count,), body = take(_WORD, body)
    rows = _words(body, 3 * count).reshape(count, 3)
    firsts = np.append(rows[:, 0], chunks + 1)
    if count and (firsts[0] != 1 or (np.diff(firsts) <= 0).any() or rows[:, 1].max() > MAX_SAMPLES):
        raise refused("the table of chunks is out of order")
    held = np.repeat(rows[:, 1], np.diff(firsts)) if count else np.zeros(0, np.int64)
    if len(held) != chunks:
        raise refused(f"{len(held)} of {chunks} chunks are described")
    return held


def _expanded(stts: memoryview, count: int) -> Int64:
    """The duration of each of `count` samples."""
    _, _, body = version_and_flags(stts)
    (entries,), body = take(_WORD, body)
    rows = _words(body, 2 * entries).reshape(entries, 2)
    if int(rows[:, 0].sum()) != count:
        raise refused(f"times of {int(rows[:, 0].sum())} samples are given for {count}")
    return np.repeat(rows[:, 1], rows[:, 0])


def _words(body: memoryview, count: int) -> Int64:
    if len(body) < 4 * count:
        raise refused(f"a table of {count} numbers has {len(body)} bytes behind it")
    return np.frombuffer(body, ">u4", count).astype(np.int64)


def _cumulated(steps: Int64) -> Int64:
    """The sum of all that come before each."""
    return np.cumsum(steps) - steps


def _check_count(count: int, most: int) -> None:
    if count > most:
        raise refused(f"{count} samples are more than the {most} that can still come")
