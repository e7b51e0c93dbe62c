"""Streams whose last packet every decoder refuses, each for one reason."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from streamlod.codec.chunks.plain import encode_plain
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.packet import PADDING, ChunkKind, Packet, make_chunk
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.entropy_model import ESCAPE, FREQUENCIES, SCALES
from streamlod.core.scene.octree import morton_key
from tests.codec import oracle
from tests.codec.scenes import grow, move
from tests.vectors.valid import key, later, packet, small

Streams = Iterator[tuple[str, list[bytes], str]]


def resign(data: bytes) -> bytes:
    """The packet with its header checksum made right."""
    (count,) = struct.unpack_from("<H", data, 30)
    checksum = zlib.crc32(data[44 : 44 + 8 * count], zlib.crc32(data[:40]))
    return data[:40] + struct.pack("<I", checksum) + data[44:]


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
    yield "cut-header", good[:43], "truncated"
    yield "cut-directory", good[:48], "truncated"
    yield "cut-chunk", good[:-1], "truncated"
    yield "trailing-byte", good + b"\0", "trailing_bytes"
    yield "magic", b"SLPX" + good[4:], "bad_magic"
    yield "version-2", patch(good, 4, b"\2"), "unsupported_version"
    yield "profile-2", patch(good, 5, b"\2"), "unsupported_profile"
    yield "kind-2", patch(good, 6, b"\2"), "bad_header"
    yield "reserved-byte", patch(good, 7, b"\1"), "bad_header"
    yield "header-checksum", good[:20] + bytes([good[20] ^ 1]) + good[21:], "bad_checksum"
    yield "directory-checksum", good[:48] + bytes([good[48] ^ 1]) + good[49:], "bad_checksum"
    yield "chunk-checksum", good[:-1] + bytes([good[-1] ^ 1]), "bad_checksum"
    yield "no-level", patch(good, 28, b"\0\0"), "bad_header"
    yield "from-version", patch(good, 12, b"\1\0\0\0"), "bad_header"
    yield "time", patch(good, 27, b"\x80"), "bad_header"


def _directory(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    entries = [good[44 + 8 * i : 52 + 8 * i] for i in range(8)]
    swapped = b"".join([entries[0], entries[1], entries[3], entries[2], *entries[4:]])
    yield "header-above-level-0", _moved(good, ChunkKind.HEADER, 1), "bad_directory"
    yield "header-without-level-0", patch(_without_chunks(good, 0), 28, b"\2\0"), "bad_directory"
    yield "missing-before-truncated", edit(good, 1, ChunkKind.BASE, lambda _: None)[:-1], "missing_chunk"
    yield "directory-before-truncated", insert_raw(good, 0, 8)[:-1], "bad_directory"
    yield "removed-in-key", insert_raw(good, 0, ChunkKind.REMOVED), "bad_directory"
    yield "extension-checksum", _damaged_extension(good), "bad_checksum"
    yield "order", patch(good, 44, swapped), "bad_directory"
    yield "repeated", patch(good, 44, entries[0] + entries[0]), "bad_directory"
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
    yield "header-of-4-bytes", header(lambda d: d[:4]), "bad_scene_header"
    yield "17-gaussians", header(lambda d: d[:1] + b"\x11" + d[2:]), "limit_exceeded"
    yield "65-features", header(lambda d: d[:2] + b"\x41" + d[3:]), "limit_exceeded"
    yield "17-levels-no-gaussians", header(lambda d: b"\x11\0" + d[2:]), "limit_exceeded"
    yield "no-gaussians", header(lambda d: d[:1] + b"\0" + d[2:]), "bad_scene_header"
    yield "no-features", header(lambda d: d[:2] + b"\0" + d[3:]), "bad_scene_header"
    yield "view-dependent-2", header(lambda d: d[:3] + b"\2" + d[4:]), "bad_scene_header"
    for name, at, number in (
        ("origin-beyond", 8, 1.1e9),
        ("origin-infinite", 16, np.inf),
        ("origin-nan", 24, np.nan),
        ("root-cell-beyond", 32, 1.1e9),
        ("root-cell-too-small", 32, 0.9e-6),
        ("reference-distance-too-small", 40, 0.9e-6),
        ("fps-beyond", 48, 10001.0),
        ("fps-too-small", 48, 0.0009),
    ):
        yield name, header(partial(_put, at=at, new=struct.pack("<d", number))), "bad_scene_header"
    for name, at, value in (("background-beyond", 56, 1.01), ("background-negative", 60, -0.01), ("step-0", 68, 0.0)):
        yield name, header(partial(_put, at=at, new=struct.pack("<f", value))), "bad_scene_header"
    yield "step-beyond", header(partial(_put, at=84, new=struct.pack("<f", 1.1e9))), "bad_scene_header"
    yield from ((f"camera-{name}", header(change), "bad_scene_header") for name, change in _CAMERAS)
    yield "camera-missing", header(lambda d: d[:4] + b"\3" + d[5:]), "bad_scene_header"
    yield "weights-longer", weights(lambda d: d + b"\0\0"), "bad_weights"
    yield "weights-infinite", weights(lambda d: b"\0\x7c" + d[2:]), "bad_weights"
    yield "mask-beyond-levels", patch(good, 28, b"\7\0"), "bad_scene_header"


def _put(data: bytes, at: int, new: bytes) -> bytes:
    """The bytes with some replaced; `at` counts from the end if it is negative."""
    at %= len(data)
    return data[:at] + new + data[at + len(new) :]


def _camera_number(place: int, number: float) -> Callable[[bytes], bytes]:
    """The last camera with the world's axes, and number `place` of its intrinsics, pose and distortion wrong."""

    def change(data: bytes) -> bytes:
        numbers = np.frombuffer(data[-8 * 26 :], "<f8").copy()
        numbers[9:21] = np.eye(3, 4).ravel()
        numbers[place] = number
        return data[: -8 * 26] + numbers.tobytes()

    return change


_CAMERAS: tuple[tuple[str, Callable[[bytes], bytes]], ...] = (
    ("focal-length-0", _camera_number(0, 0.0)),
    ("focal-length-negative", _camera_number(4, -1.0)),
    ("number-beyond", _camera_number(12, 1.1e12)),
    ("number-nan", _camera_number(25, np.nan)),
    ("mirrored", _camera_number(9, -1.0)),
    ("sheared", _camera_number(10, 0.01)),
    ("width-0", lambda d: _put(d, -8 * 26 - 8, bytes(4))),
    ("height-65536", lambda d: _put(d, -8 * 26 - 4, b"\0\0\1\0")),
    ("name-of-65-bytes", lambda d: _put(d, -8 * 26 - 14, b"\x41")),
    ("name-no-text", lambda d: _put(d, -8 * 26 - 13, b"\xff")),
)  # fmt: skip


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
    yield "octree-without-rows", geometry(lambda d: d[:1] + bytes(4) + d[5:]), "corrupt_chunk"
    yield "octree-too-deep", geometry(partial(_octree, depth=5, shift=0)), "corrupt_chunk"
    yield "octree-above-its-minimum", geometry(partial(_octree, depth=2, shift=1)), "corrupt_chunk"
    yield "octree-of-one-too-deep", geometry(lambda _: _octree_of([(0, 0, 0)], 3)), "corrupt_chunk"
    yield "octree-few-bytes", geometry(lambda _: _octree_of(_cube(16), 4)), "limit_exceeded"
    yield "geometry-few-bytes", edit(plain, 1, ChunkKind.GEOMETRY, lambda _: _zeros(40_000, 3)), "limit_exceeded"
    yield "plain-without-rows", edit(plain, 1, ChunkKind.GEOMETRY, lambda _: _zeros(0, 3)), "corrupt_chunk"
    yield "base-few-bytes", _few_base(good, 1), "limit_exceeded"
    yield "plain-base-few-bytes", _few_base(plain, 0), "limit_exceeded"
    yield "hash", edit(good, 1, ChunkKind.HASH, lambda d: bytes([d[0] ^ 1]) + d[1:]), "state_mismatch"
    yield "hash-length", edit(good, 0, ChunkKind.HASH, lambda d: d + b"\0"), "corrupt_chunk"
    yield "hash-of-empty-level", _hash_of_empty(good), "state_mismatch"
    yield "mode-3", base(lambda d: d[:1] + bytes([d[1] | 3]) + d[2:]), "corrupt_chunk"
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
    yield "level-of-other-run", patch(bare, 32, b"\1"), "unknown_keyframe"
    yield "level-of-other-run-beyond-scene", patch(patch(bare, 32, b"\1"), 28, b"\7\0"), "unknown_keyframe"
    yield "level-beyond-scene", patch(bare, 28, b"\7\0"), "bad_scene_header"


def _without_header(good: bytes) -> bytes:
    parsed = parse(good)
    return build(replace(parsed, chunks=tuple(c for c in parsed.chunks if not c.belongs_to_scene)))


def _moved(good: bytes, kind: int, level: int) -> bytes:
    """The packet with a chunk of level 0 filed under another."""
    parsed = parse(good)
    chunks = (replace(c, level=level) if c.kind == kind else c for c in parsed.chunks)
    return build(replace(parsed, chunks=tuple(sorted(chunks, key=lambda c: (c.level, c.kind)))))


def _without_chunks(good: bytes, level: int) -> bytes:
    """The packet without chunks of a level, but for header and weights."""
    parsed = parse(good)
    return build(replace(parsed, chunks=tuple(c for c in parsed.chunks if c.belongs_to_scene or c.level != level)))


def _damaged_extension(good: bytes) -> bytes:
    padded = insert(good, 1, PADDING, bytes(8))
    return padded[:-1] + b"\1"


def _hash_of_empty(good: bytes) -> bytes:
    return insert(_without_header(_without_chunks(good, 1)), 1, ChunkKind.HASH, b"\1\0\0\0")


def _zeros(rows: int, columns: int) -> bytes:
    return encode_plain(np.zeros((rows, columns), np.int64))


def _octree_of(voxels: list[tuple[int, int, int]], depth: int) -> bytes:
    """A GEOMETRY chunk of one lane with these voxels, in Morton order."""
    encoder = oracle.Encoder()
    oracle.octree(encoder, depth, len(voxels), voxels)
    words = np.array(encoder.words(1), "<u2").tobytes()
    return struct.pack("<BIiiiB", 1, len(voxels), 0, 0, 0, depth) + words


def _octree(_: bytes, depth: int, shift: int) -> bytes:
    return _octree_of([(shift, shift, shift), (shift + 2, shift + 2, shift + 2)], depth)


def _cube(width: int) -> list[tuple[int, int, int]]:
    """All voxels of a cube in Morton order."""
    voxels = np.stack(np.meshgrid(*[np.arange(width)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    ordered = voxels[np.argsort(morton_key(voxels))].tolist()
    return [(int(x), int(y), int(z)) for x, y, z in ordered]


def _few_base(good: bytes, profile: int) -> bytes:
    """A level of 4096 rows alike whose chunks have too few bytes for BASE, though enough for GEOMETRY."""
    scene = small((1, 1), seed=1)
    level = scene.levels[1]
    alike = {name: np.repeat(getattr(level, name)[:1], 4096, axis=0) for name in AnchorLevel.__slots__}
    full = AnchorLevel(**{**alike, "voxel": np.array(_cube(16), np.int32)})
    parsed = parse(key(replace(scene, levels=(scene.levels[0], full)), profile))
    chunks = [c for c in parsed.chunks if c.level == 1 and c.kind in (ChunkKind.GEOMETRY, ChunkKind.BASE)]
    return build(replace(parse(_without_header(_without_chunks(good, 1))), chunks=tuple(chunks), level_mask=2))


def _versions(good: bytes) -> Iterator[tuple[str, bytes, str]]:
    yield "of-other-keyframe", patch(good, 8, struct.pack("<III", 1, 1, 2)), "unknown_keyframe"
    yield "of-other-run", patch(good, 32, b"\1"), "unknown_keyframe"
    yield "beyond-scene", patch(good, 28, b"\7\0"), "bad_scene_header"
    yield "beyond-scene-of-later-version", patch(_later(good), 28, b"\7\0"), "bad_scene_header"
    yield "header-in-change", insert_raw(good, 0, ChunkKind.HEADER), "bad_directory"
    yield "kind-8", insert_raw(good, 0, 8), "bad_directory"
    yield "of-later-version", patch(good, 12, struct.pack("<II", 5, 6)), "version_mismatch"
    yield "backwards", patch(good, 12, struct.pack("<II", 1, 1)), "bad_header"
    yield "geometry-in-change", insert_raw(good, 1, ChunkKind.GEOMETRY), "bad_directory"


def _later(good: bytes) -> bytes:
    return patch(good, 12, struct.pack("<II", 5, 6))


def _changes(good: bytes, plain: bytes) -> Iterator[tuple[str, bytes, str]]:
    def change(edited: Callable[[bytes], bytes]) -> bytes:
        return edit(good, 1, ChunkKind.CHANGE, edited)

    yield "words-cut", change(lambda d: d[:-2]), "corrupt_chunk"
    yield "words-odd", change(lambda d: d[:-1]), "corrupt_chunk"
    yield "words-more", change(lambda d: d + b"\0\0"), "corrupt_chunk"
    yield "words-other", change(lambda d: d[:-2] + bytes([d[-2] ^ 16, d[-1]])), "corrupt_chunk"
    yield "empty", change(lambda _: b""), "corrupt_chunk"
    yield "one-byte", change(lambda d: d[:1]), "corrupt_chunk"
    yield "position-scale-192", change(lambda d: d[:1] + b"\xc0" + d[2:]), "corrupt_chunk"
    yield "of-no-rows", change(lambda _: _coded_change([])), "corrupt_chunk"
    yield "escape-too-wide", change(lambda _: _coded_change([31])), "corrupt_chunk"
    yield "number-too-large", change(lambda _: _coded_change([30])), "corrupt_chunk"
    yield "coding-3", change(lambda d: b"\3" + d[1:]), "unsupported_profile"
    yield "state-too-small", change(_small_state), "corrupt_chunk"
    yield "scale-beyond-table", change(lambda d: d[:2] + b"\xbf\xff" + d[4:]), "corrupt_chunk"
    yield "side-fields-cut", change(lambda d: d[:9]), "corrupt_chunk"
    far = np.zeros((1, 28), np.int64)
    far[0, 0] = 20
    yield "row-beyond", edit(plain, 1, ChunkKind.CHANGE, lambda _: encode_plain(far)), "corrupt_chunk"
    yield "row-negative", edit(plain, 1, ChunkKind.CHANGE, lambda _: encode_plain(-far // 20)), "corrupt_chunk"
    yield "more-rows-than-there-are", edit(plain, 1, ChunkKind.CHANGE, lambda _: _zeros(21, 28)), "corrupt_chunk"
    yield "plain-of-no-rows", edit(plain, 1, ChunkKind.CHANGE, lambda _: _zeros(0, 28)), "corrupt_chunk"
    yield "deflate", edit(plain, 1, ChunkKind.CHANGE, lambda d: d[:5] + b"\xff" * 9), "corrupt_chunk"
    yield "deflate-cut", edit(plain, 1, ChunkKind.CHANGE, lambda d: d[:-2]), "corrupt_chunk"
    yield "deflate-more", edit(plain, 1, ChunkKind.CHANGE, lambda d: d + b"\0"), "corrupt_chunk"
    twice = encode_plain(np.array([[2], [0]]))
    yield "removed-twice", insert(good, 1, ChunkKind.REMOVED, twice), "corrupt_chunk"
    yield "removed-none", insert(good, 1, ChunkKind.REMOVED, _zeros(0, 1)), "corrupt_chunk"
    yield "removed-beyond", insert(good, 1, ChunkKind.REMOVED, encode_plain(np.array([[20]]))), "corrupt_chunk"
    yield "removed-too-many", insert(good, 1, ChunkKind.REMOVED, _zeros(21, 1)), "corrupt_chunk"
    yield "removed-coding", insert(good, 1, ChunkKind.REMOVED, b"\1" + twice[1:]), "unsupported_profile"
    yield "hash-length", edit(good, 1, ChunkKind.HASH, lambda _: b"\0\0\0"), "corrupt_chunk"
    yield "hash", edit(good, 1, ChunkKind.HASH, lambda _: b"\0\0\0\0"), "state_mismatch"


def _coded_change(widths: list[int]) -> bytes:
    """A CHANGE chunk of one lane for a level of 20 rows in which the first `widths` rows change.

    Each first position difference is an escape of so many bits; everything else is 0.
    """
    encoder = oracle.Encoder()
    oracle.dynamic_set(encoder, [0] * 20, [1] * len(widths) + [0] * (20 - len(widths)))
    for width in widths:
        encoder.interval(FREQUENCIES[oracle.magnitude_bin(int(SCALES[0]))].tolist(), ESCAPE)
        for bit in [1] * width + [0]:
            oracle.raw(encoder, 1, bit)
        oracle.raw(encoder, width, 0)
    return bytes([1, 0, 0]) + bytes(12) + np.array(encoder.words(1), "<u2").tobytes()


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
    wrong = edit(packet(scene, replace(grown, version=2)), 1, ChunkKind.HASH, lambda d: bytes([d[0] ^ 1]) + d[1:])
    yield "skip-hash", [key(scene), wrong], "state_mismatch"
    yield from _added(scene, added)
    yield from _deaths(scene)


def _added(scene: Scene, good: bytes) -> Streams:
    """Rows that are added wrongly."""
    first, columns = key(scene), 2 + 3 + 38

    def added(matrix: np.ndarray) -> list[bytes]:
        return [first, edit(good, 1, ChunkKind.ADDED, lambda _: encode_plain(matrix))]

    row = np.zeros((1, columns), np.int64)
    alive, latent = row.copy(), row.copy()
    alive[0, -1], latent[0, -2] = 2, 40000
    yield "added-alive-2", added(alive), "overflow"
    yield "added-latent-beyond", added(latent), "overflow"
    yield "added-none", added(row[:0]), "corrupt_chunk"
    yield "added-plain-few-bytes", added(np.zeros((5000, columns), np.int64)), "limit_exceeded"
    uncoded = _uncoded(5000, columns)
    few = edit(packet(scene, grow(scene)), 1, ChunkKind.ADDED, lambda _: uncoded)
    yield "added-uncoded-few-bytes", [first, few], "limit_exceeded"


def _uncoded(rows: int, columns: int) -> bytes:
    """An ADDED chunk of rows in which no channel is coded: as many as it says, for nothing."""
    modes, scales = bytes(-(-columns // 4)), bytes(1 + -(-columns // 2))
    words = np.array(oracle.Encoder().words(1), "<u2").tobytes()
    return struct.pack("<BI", 1, rows) + modes + b"\1" + scales + words


def _deaths(scene: Scene) -> Streams:
    """A row that dies twice, and rows that die for too few bytes."""
    alive = scene.levels[0].alive.copy()
    alive[1] = False
    dead = later(scene, alive=alive)
    still = packet(dead, replace(dead, version=2), profile=0)
    again = insert(still, 0, ChunkKind.REMOVED, encode_plain(np.array([[1]])))
    yield "removed-again", [key(scene), packet(scene, dead), again], "corrupt_chunk"
    level = small((700,)).levels[0]
    many = AnchorLevel(*(np.resize(getattr(level, n), (4096, *getattr(level, n).shape[1:])) for n in level.__slots__))
    crowd = replace(scene, levels=(replace(many, alive=np.ones(4096, np.bool_)), scene.levels[1]))
    nothing = packet(crowd, replace(crowd, version=1))
    gaps = np.ones((4096, 1), np.int64)
    gaps[0] = 0
    few = insert(nothing, 0, ChunkKind.REMOVED, encode_plain(gaps))
    yield "removed-few-bytes", [key(crowd), few], "limit_exceeded"
