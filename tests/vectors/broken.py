"""Streams whose last packet every decoder refuses, each for one reason."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from codec.chunks.plain import encode_plain
from codec.packet.bytes import build, parse
from codec.packet.packet import ChunkKind, Packet, make_chunk
from core.scene.anchors import Scene
from tests.codec.scenes import grow, move
from tests.vectors.valid import key, later, packet, small

Streams = Iterator[tuple[str, list[bytes], str]]


def resign(data: bytes) -> bytes:
    """The packet with its header checksum made right."""
    (count,) = struct.unpack_from("<H", data, 30)
    checksum = zlib.crc32(data[36 : 36 + 8 * count], zlib.crc32(data[:32]))
    return data[:32] + struct.pack("<I", checksum) + data[36:]


def patch(data: bytes, at: int, new: bytes) -> bytes:
    """The packet with bytes replaced and its header checksum made right."""
    return resign(data[:at] + new + data[at + len(new) :])


def edit(data: bytes, level: int, kind: int, change: Callable[[bytes], bytes | None]) -> bytes:
    """The packet with one chunk changed, or removed where `change` gives None."""
    parsed = parse(data)
    chunks = []
    for chunk in parsed.chunks:
        new = change(chunk.data) if (chunk.level, chunk.kind) == (level, kind) else chunk.data
        if new is not None:
            chunks.append(make_chunk(chunk.level, chunk.kind, new))
    return build(replace(parsed, chunks=tuple(chunks)))


def insert(data: bytes, level: int, kind: int, content: bytes) -> bytes:
    """The packet with one more chunk."""
    parsed: Packet = parse(data)
    chunks = sorted([*parsed.chunks, make_chunk(level, kind, content)], key=lambda c: (c.level, c.kind))
    return build(replace(parsed, chunks=tuple(chunks)))


def broken_streams() -> Streams:
    """Name, packets and refusal code of each stream."""
    scene = small()
    following = move(scene, 1, 0.5)
    good_key, good = key(scene), packet(scene, following)
    for name, data, code in (*_envelope(good_key), *_directory(good_key), *_scene_chunks(good_key)):
        yield f"key-{name}", [data], code
    for name, data, code in (*_key_levels(good_key, key(scene, 0)), *_beyond(good_key)):
        yield f"key-{name}", [good_key, data], code
    for name, data, code in (*_versions(good), *_changes(good, packet(scene, following, profile=0))):
        yield f"change-{name}", [good_key, data], code
    yield "change-without-keyframe", [good], "no_keyframe"
    yield "level-without-keyframe", [_without_header(good_key)], "no_keyframe"
    yield "change-twice", [good_key, good, good], "version_mismatch"
    yield from _states(scene)


def _envelope(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    yield "empty", b"", "truncated"
    yield "cut-header", good[:35], "truncated"
    yield "cut-directory", good[:40], "truncated"
    yield "cut-chunk", good[:-1], "truncated"
    yield "trailing-byte", good + b"\0", "trailing_bytes"
    yield "magic", b"SLPX" + good[4:], "bad_magic"
    yield "version-2", patch(good, 4, b"\2"), "unsupported_version"
    yield "profile-2", patch(good, 5, b"\2"), "unsupported_profile"
    yield "kind-4", patch(good, 6, b"\4"), "bad_header"
    yield "reserved-byte", patch(good, 7, b"\1"), "bad_header"
    yield "header-checksum", good[:20] + bytes([good[20] ^ 1]) + good[21:], "bad_checksum"
    yield "directory-checksum", good[:40] + bytes([good[40] ^ 1]) + good[41:], "bad_checksum"
    yield "chunk-checksum", good[:-1] + bytes([good[-1] ^ 1]), "bad_checksum"
    yield "no-level", patch(good, 28, b"\0\0"), "bad_header"
    yield "from-version", patch(good, 12, b"\1\0\0\0"), "bad_header"
    yield "time", patch(good, 27, b"\x80"), "bad_header"


def _directory(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    entries = [good[36 + 8 * i : 44 + 8 * i] for i in range(6)]
    swapped = b"".join([entries[0], entries[1], entries[3], entries[2], *entries[4:]])
    yield "order", patch(good, 36, swapped), "bad_directory"
    yield "repeated", patch(good, 36, entries[0] + entries[0]), "bad_directory"
    yield "unknown-chunk", insert_raw(good, 0, 9), "bad_directory"
    yield "change-in-key", insert_raw(good, 0, ChunkKind.CHANGE), "bad_directory"
    yield "level-outside-mask", patch(good, 28, b"\1\0"), "bad_directory"
    yield "no-weights", edit(good, 0, ChunkKind.WEIGHTS, lambda _: None), "missing_chunk"
    yield "no-base", edit(good, 1, ChunkKind.BASE, lambda _: None), "missing_chunk"


def insert_raw(good: bytes, level: int, kind: int) -> bytes:
    """The packet with an empty chunk of any kind."""
    return insert(good, level, kind, b"")


def _scene_chunks(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    def header(change: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 0, ChunkKind.HEADER, change)

    def weights(change: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 0, ChunkKind.WEIGHTS, change)

    nan, minus = struct.pack("<f", np.nan), struct.pack("<d", -1.0)
    yield "header-cut", header(lambda d: d[:-1]), "bad_scene_header"
    yield "header-longer", header(lambda d: d + b"\0"), "bad_scene_header"
    yield "no-levels", header(lambda d: b"\0" + d[1:]), "bad_scene_header"
    yield "17-levels", header(lambda d: b"\x11" + d[1:]), "limit_exceeded"
    yield "header-reserved", header(lambda d: d[:7] + b"\1" + d[8:]), "bad_scene_header"
    yield "nan-step", header(lambda d: d[:68] + nan + d[72:]), "bad_scene_header"
    yield "negative-fps", header(lambda d: d[:48] + minus + d[56:]), "bad_scene_header"
    yield "no-rotation", header(lambda d: d[:-136] + struct.pack("<d", 7.0) + d[-128:]), "bad_scene_header"
    yield "weights-cut", weights(lambda d: d[:-2]), "bad_weights"
    yield "weights-nan", weights(lambda d: d[:-2] + b"\xff\x7e"), "bad_weights"
    yield "mask-beyond-levels", patch(good, 28, b"\7\0"), "bad_scene_header"


def _key_levels(good: bytes, plain: bytes) -> Iterator[tuple[str, bytes, str]]:
    def geometry(change: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 1, ChunkKind.GEOMETRY, change)

    def base(change: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 1, ChunkKind.BASE, change)

    many = struct.pack("<I", (1 << 20) + 1)
    yield "too-many-anchors", geometry(lambda d: d[:1] + many + d[5:]), "limit_exceeded"
    yield "octree-count", geometry(lambda d: d[:1] + b"\3\0\0\0" + d[5:]), "corrupt_chunk"
    yield "octree-depth", geometry(lambda d: d[:17] + b"\x16" + d[18:]), "corrupt_chunk"
    yield "octree-overflow", geometry(lambda d: d[:5] + b"\xff\xff\xff\x7f" + d[9:]), "overflow"
    yield "octree-words", geometry(lambda d: d[:-2] + b"\1\1"), "corrupt_chunk"
    yield "coding-2", base(lambda d: b"\2" + d[1:]), "unsupported_profile"
    yield "empty-base", base(lambda _: b""), "corrupt_chunk"
    yield "no-class", base(lambda d: _with_classes(d, 0)), "corrupt_chunk"
    yield "class-without-scales", base(lambda d: _with_classes(d, 255)), "corrupt_chunk"
    yield "channel-modes-beyond", base(lambda d: d[:4] + bytes([d[4] | 0xC0]) + d[5:]), "corrupt_chunk"
    yield "coding-4-in-profile-0", patch(good, 5, b"\0"), "unsupported_profile"
    rows = struct.pack("<I", 1)
    yield "plain-rows", edit(plain, 1, ChunkKind.BASE, lambda d: d[:1] + rows + d[5:]), "corrupt_chunk"
    yield "plain-overflow", edit(plain, 0, ChunkKind.BASE, lambda d: encode_plain(_huge(d))), "overflow"


def _with_classes(data: bytes, mask: int) -> bytes:
    """A BASE chunk of 15 channels with another byte of classes."""
    modes = [data[1 + c // 4] >> 2 * (c % 4) & 3 for c in range(15)]
    at = 1 + 4 + 4 * modes.count(1)
    return data[:at] + bytes([mask]) + data[at + 1 :]


def _huge(data: bytes) -> np.ndarray:
    (rows,) = struct.unpack_from("<I", data, 1)
    return np.full((rows, 2 + 3 + 10), 40000)


def _beyond(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    """Levels without header: another keyframe, a level that the scene has not."""
    bare = _without_header(good)
    other = b"".join([struct.pack("<I", 5)] * 3)
    yield "level-of-other-keyframe", patch(bare, 8, other), "unknown_keyframe"
    yield "level-beyond-scene", patch(bare, 28, b"\7\0"), "bad_scene_header"


def _without_header(good: bytes) -> bytes:
    parsed = parse(good)
    return build(replace(parsed, chunks=tuple(c for c in parsed.chunks if not c.belongs_to_scene)))


def _versions(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    yield "of-other-keyframe", patch(good, 8, struct.pack("<III", 1, 1, 2)), "unknown_keyframe"
    yield "of-later-version", patch(good, 12, struct.pack("<II", 5, 6)), "version_mismatch"
    yield "backwards", patch(good, 12, struct.pack("<II", 1, 1)), "bad_header"
    yield "catch-up-from-1", patch(patch(good, 6, b"\3"), 12, struct.pack("<II", 1, 2)), "bad_header"
    yield "geometry-in-change", insert_raw(good, 1, ChunkKind.GEOMETRY), "bad_directory"


def _changes(good: bytes, plain: bytes) -> Iterator[tuple[str, bytes, str]]:
    def change(edited: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 1, ChunkKind.CHANGE, edited)

    yield "words-cut", change(lambda d: d[:-2]), "corrupt_chunk"
    yield "words-odd", change(lambda d: d[:-1]), "corrupt_chunk"
    yield "words-more", change(lambda d: d + b"\0\0"), "corrupt_chunk"
    yield "words-other", change(lambda d: d[:-2] + bytes([d[-2] ^ 16, d[-1]])), "corrupt_chunk"
    yield "state-too-small", change(_small_state), "corrupt_chunk"
    yield "scale-beyond-table", change(lambda d: d[:2] + b"\xbf\xff" + d[4:]), "corrupt_chunk"
    yield "side-fields-cut", change(lambda d: d[:9]), "corrupt_chunk"
    far = np.zeros((1, 28), np.int64)
    far[0, 0] = 20
    yield "row-beyond", edit(plain, 1, ChunkKind.CHANGE, lambda _: encode_plain(far)), "corrupt_chunk"
    yield "deflate", edit(plain, 1, ChunkKind.CHANGE, lambda d: d[:5] + b"\xff" * 9), "corrupt_chunk"
    yield "deflate-cut", edit(plain, 1, ChunkKind.CHANGE, lambda d: d[:-2]), "corrupt_chunk"
    yield "deflate-more", edit(plain, 1, ChunkKind.CHANGE, lambda d: d + b"\0"), "corrupt_chunk"
    twice = encode_plain(np.array([[2], [0]]))
    yield "removed-twice", insert(good, 1, ChunkKind.REMOVED, twice), "corrupt_chunk"
    yield "removed-coding", insert(good, 1, ChunkKind.REMOVED, b"\1" + twice[1:]), "unsupported_profile"
    yield "hash-length", insert(good, 1, ChunkKind.HASH, b"\0\0\0"), "corrupt_chunk"
    yield "hash", insert(good, 1, ChunkKind.HASH, b"\0\0\0\0"), "state_mismatch"


def _small_state(data: bytes) -> bytes:
    at = 3 if data[2] >= 192 else 15
    return data[:at] + b"\0\0\0\0" + data[at + 4 :]


def _states(scene: Scene) -> Streams:
    level = scene.levels[0]
    latent, position = level.latent.copy(), level.position.copy()
    latent[0, 0], position[0, 0] = 32767, 2**31 - 50
    full = later(scene, latent=latent, position=position)
    one, zero = np.zeros((1, 28), np.int64), np.zeros((1, 28), np.int64)
    one[0, 4], zero[0, 1] = 1, 100
    still = packet(full, replace(full, version=2), profile=0)
    first = [key(scene), packet(scene, full)]
    yield "latent-overflow", [*first, insert(still, 0, ChunkKind.CHANGE, encode_plain(one))], "overflow"
    yield "position-overflow", [*first, insert(still, 0, ChunkKind.CHANGE, encode_plain(zero))], "overflow"
    grown = grow(scene)
    added = packet(scene, grown, profile=0)
    many = struct.pack("<I", 1 << 20)
    cut = edit(added, 1, ChunkKind.ADDED, lambda d: d[:1] + many + d[5:])
    yield "added-too-many", [key(scene), cut], "limit_exceeded"
    skip = edit(packet(scene, grown, "skip"), 1, ChunkKind.HASH, lambda d: bytes([d[0] ^ 1]) + d[1:])
    yield "skip-hash", [key(scene), skip], "state_mismatch"
