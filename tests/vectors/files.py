"""`.slod` files for every reader: good, wrong and lying indexes; levels apart (codec/FORMAT.md section 15)."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from streamlod.codec.container.layout import FILE_HEAD, FOOTER, FOOTER_MAGIC, Entry, entry_of, file_end, record
from streamlod.codec.packet.info import peek
from streamlod.codec.packet.levels import split_levels
from streamlod.core.scene.residual import difference
from tests.codec.scenes import move
from tests.vectors.valid import key, packet, small

Files = Iterator[tuple[str, bytes]]


def file_vectors() -> Files:
    """Name and content of each file."""
    packets = _clip()
    records, entries = _records(packets), _entries(packets)
    yield "whole", _file(records, entries)
    yield "gap-in-index", _file(records, [*entries[:2], *entries[3:]])
    yield "repeated-entry", _file(records, [*entries[:2], *entries[1:]])
    yield "descending-entries", _file(records, entries[::-1])
    overlapping = replace(entries[2], offset=entries[2].offset - 1, size_bytes=entries[2].size_bytes + 1)
    yield "overlapping-entries", _file(records, [*entries[:2], overlapping, *entries[3:]])
    yield "entry-beyond-records", _file(records, [*entries[:-1], replace(entries[-1], size_bytes=10**6)])
    yield "entry-too-large", _file(records, [*entries[:-1], replace(entries[-1], size_bytes=1 << 24 | 1)])
    yield "offset-beyond-2-53", _file(records, [*entries[:-1], replace(entries[-1], offset=2**63 + 8)])
    yield "index-checksum", _signed(_file(records, entries), lambda index: index, checksum=1)
    yield "index-mark", _signed(_file(records, entries), lambda index: b"\0" + index[1:])
    yield "index-count", _signed(_file(records, entries), lambda index: index[:4] + b"\2" + index[5:])
    yield "index-kind-2", _signed(_file(records, entries), lambda index: index[:40] + b"\2" + index[41:])
    yield "no-index", FILE_HEAD + records
    yield "torn", FILE_HEAD + records[:-9]
    yield "empty", file_of([])
    for field, wrong in (
        ("keyframe", 1),
        ("from_version", 1),
        ("to_version", 9),
        ("time_ns", entries[1].time_ns + 1),
        ("level_mask", 7),
        ("size_bytes", 43),
        ("size_bytes", entries[1].size_bytes - 1),
    ):
        name = f"index-lies-of-{field.replace('_', '-')}" + ("-by-one" if wrong == entries[1].size_bytes - 1 else "")
        changes: dict[str, Any] = {field: wrong}
        yield name, _file(records, [entries[0], replace(entries[1], **changes), *entries[2:]])
    yield "levels-apart", file_of([part for whole in packets for part in split_levels(whole)])
    yield "level-after-level", file_of(_level_after_level(packets))
    yield "levels-apart-or-whole", file_of([*_apart(packets[:3]), packets[2], *packets[3:]])
    yield "two-runs", file_of([*packets[:2], key(replace(small((3, 5)), identifier=9)), packets[2]])


def file_of(packets: Sequence[bytes]) -> bytes:
    """A file of these packets with its index."""
    return _file(_records(packets), _entries(packets))


def _clip() -> list[bytes]:
    """A keyframe, three predicted packets, and the skip from version 1 to 3."""
    states = [small((3, 5))]
    for seed in range(3):
        states.append(move(states[-1], seed, 0.5))
    pairs = ((0, 1), (1, 2), (2, 3), (1, 3))
    assert all(difference(states[a], states[b]) for a, b in pairs)
    return [key(states[0]), *(packet(states[a], states[b]) for a, b in pairs)]


def _apart(packets: Sequence[bytes]) -> list[bytes]:
    return [part for whole in packets for part in split_levels(whole)]


def _level_after_level(packets: Sequence[bytes]) -> list[bytes]:
    """All of level 0, then all of level 1."""
    return [split_levels(whole)[level] for level in (0, 1) for whole in packets]


def _records(packets: Sequence[bytes]) -> bytes:
    return b"".join(map(record, packets))


def _entries(packets: Sequence[bytes]) -> list[Entry]:
    entries, at = [], len(FILE_HEAD)
    for data in packets:
        entries.append(entry_of(peek(data), at + 4))
        at += 4 + len(data)
    return entries


def _file(records: bytes, entries: Sequence[Entry]) -> bytes:
    return FILE_HEAD + records + file_end(entries, len(FILE_HEAD) + len(records))


def _signed(file: bytes, change: Callable[[bytes], bytes], checksum: int = 0) -> bytes:
    """The file with another index, its checksum right but for the bits of `checksum`."""
    at, _, _ = FOOTER.unpack(file[-FOOTER.size :])
    index = change(file[at : -FOOTER.size])
    return file[:at] + index + FOOTER.pack(at, zlib.crc32(index) ^ checksum, FOOTER_MAGIC)
