"""Streams whose last packet announces far more than its bytes can carry, or as much as they may; for both decoders."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np

from streamlod.codec.chunks.plain import encode_plain
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.limits import MAX_NUMBERS_A_BYTE
from streamlod.codec.packet.packet import PADDING, ChunkKind, make_chunk
from tests.codec import oracle
from tests.codec.scenes import grow, make_scene
from tests.vectors.valid import key, packet


def exchanged(data: bytes, level: int, kind: int, content: bytes) -> bytes:
    """The packet with one chunk exchanged or added."""
    parsed = parse(data)
    chunks = [c for c in parsed.chunks if (c.level, c.kind) != (level, kind)] + [make_chunk(level, kind, content)]
    return build(replace(parsed, chunks=tuple(sorted(chunks, key=lambda c: (c.level, c.kind)))))


def uncoded(rows: int, columns: int) -> bytes:
    """An ADDED chunk of rows that cost no items at all."""
    words = np.array(oracle.Encoder().words(1), "<u2").tobytes()
    fields = bytes(-(-columns // 4)) + b"\1" + bytes(1 + -(-columns // 2))
    return struct.pack("<BI", 1, rows) + fields + words


def hostile() -> dict[str, list[bytes]]:
    """Streams whose last packet announces far more than its bytes can carry."""
    scene = make_scene((5, 5))
    first, change = key(scene), packet(scene, grow(scene))
    rows, columns = 1 << 18, 32 + 12 + 38
    plain = key(scene, 0)
    base_rows = 1 << 17
    base = exchanged(plain, 1, ChunkKind.GEOMETRY, encode_plain(np.zeros((base_rows, 3), np.int64)))
    return {
        "added for nothing": [first, exchanged(change, 1, ChunkKind.ADDED, uncoded(rows, columns))],
        "more added for nothing": [first, exchanged(change, 1, ChunkKind.ADDED, uncoded(4 * rows, columns))],
        "added under deflate": [
            first,
            exchanged(change, 1, ChunkKind.ADDED, encode_plain(np.zeros((20_000, columns)))),
        ],
        "keyframe under deflate": [
            exchanged(base, 1, ChunkKind.BASE, encode_plain(np.zeros((base_rows, 54), np.int32)))
        ],
        "octree": [exchanged(first, 1, ChunkKind.GEOMETRY, _octree(rows, 18))],
    }


def _octree(rows: int, depth: int) -> bytes:
    return struct.pack("<BIiiiB", 1, rows, 0, 0, 0, depth) + b"\0\0\1\0" * 40


def densest(rows: int) -> list[bytes]:
    """`rows` rows that cost nothing, in as few bytes as are accepted."""
    scene = make_scene((5, 5))
    columns = 32 + 12 + 38
    content = uncoded(rows, columns)
    change = exchanged(packet(scene, grow(scene)), 1, ChunkKind.ADDED, content)
    change = exchanged(change, 1, PADDING, bytes(-(-rows * columns // MAX_NUMBERS_A_BYTE) - len(content)))
    parsed = parse(change)
    return [key(scene), build(replace(parsed, chunks=tuple(c for c in parsed.chunks if c.kind != ChunkKind.HASH)))]


def stream_bytes(packets: list[bytes]) -> bytes:
    """A stream file (codec/FORMAT.md section 16)."""
    return b"".join(struct.pack("<I", len(data)) + data for data in packets)
