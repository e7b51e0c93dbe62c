"""Streams that every decoder reads."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from streamlod.codec.chunks.metadata import encode_metadata
from streamlod.codec.chunks.plain import encode_plain
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.bytes import build, parse
from streamlod.codec.packet.levels import drop_levels, select_levels, split_levels
from streamlod.codec.packet.packet import METADATA, ChunkKind, make_chunk
from streamlod.core.scene.anchors import AnchorLevel, Scene, empty_level
from streamlod.core.scene.exposures import CameraExposure
from streamlod.core.scene.metadata import Metadata, Original
from streamlod.core.scene.octree import Octree
from streamlod.core.scene.residual import difference
from tests.codec.scenes import grow, make_scene, move

Streams = Iterator[tuple[str, list[bytes]]]


def small(counts: tuple[int, ...] = (4, 20), seed: int = 0) -> Scene:
    """A scene with one Gaussian an anchor and two features."""
    return make_scene(counts, seed, slots=1, features=2)


def key(scene: Scene, profile: int = 1) -> bytes:
    """The key packet of a scene."""
    return encode_keyframe(scene, time_ns=scene.version * 33_366_700, profile=profile)


def packet(a: Scene, b: Scene, profile: int = 1) -> bytes:
    """The packet from `a` to `b`."""
    return encode_residual(a, difference(a, b), time_ns=b.version * 33_366_700, profile=profile)


def later(scene: Scene, **columns: np.ndarray) -> Scene:
    """The next version, with columns of level 0 replaced."""
    return replace(scene, levels=(replace(scene.levels[0], **columns), *scene.levels[1:]), version=scene.version + 1)


def valid_streams() -> Streams:
    """Name and packets of each stream."""
    for profile in (0, 1):
        yield f"chain-profile{profile}", _chain(make_scene((6, 30, 90)), profile)
        yield f"growth-profile{profile}", _growth(profile)
        yield f"skip-profile{profile}", _skip(profile)
        yield f"extremes-profile{profile}", _extremes(profile)
    for count in (0, 1, 63, 64, 65):
        yield f"{count}-anchors", _chain(_count(count), 1)
    yield "four-lanes", _chain(make_scene((20, 100, 600)), 1, share=0.6)
    yield "still", _still()
    yield "everything-moves", _chain(small((10, 70)), 1, share=1.0)
    yield "steady-motion", _steady()
    yield "trickle", _trickle()
    yield "levels-apart", _levels_apart()
    yield "state-hash", _state_hash()
    yield "second-keyframe", _second_keyframe()
    yield "same-voxel-twice", _same_voxel()
    yield "extension-chunk", _extension()
    yield "no-cameras-no-view", _bare()
    yield "classes", _classes()
    for profile in (0, 1):
        yield f"padding-profile{profile}", _padding(profile)
        yield f"rows-that-die-profile{profile}", _deaths(profile)
        yield f"level-0-empty-profile{profile}", _first_level_empty(profile)
    yield "another-run", _another_run()
    yield "numbers-at-their-bounds", _bounds()
    yield "everything-at-its-most", _most()
    yield "octree-of-depth-21", _deep()
    for name, level, strategy in (("stored", 0, 0), ("fixed", 9, zlib.Z_FIXED), ("many-blocks", 9, zlib.Z_FULL_FLUSH)):
        yield f"deflate-{name}", _deflated(level, strategy)
    yield "change-of-nothing", _nothing()
    yield "one-lane-key", _lanes()
    yield "metadata", _metadata()
    yield "metadata-exposures", _exposures()
    for name, content in _odd_metadata():
        yield f"metadata-{name}", _with_metadata(content)


def _chain(scene: Scene, profile: int, share: float = 0.3) -> list[bytes]:
    packets = [key(scene, profile)]
    for seed in range(3):
        following = move(scene, seed, share)
        packets.append(packet(scene, following, profile=profile))
        scene = following
    return packets


def _classes() -> list[bytes]:
    """A keyframe whose rows end in different numbers of zeros, in classes too small to be kept and large enough."""
    scene = small((40, 300))
    rng, levels = np.random.default_rng(3), []
    for level, most in zip(scene.levels, (3, 10), strict=True):
        unit = 2 ** np.minimum(rng.integers(0, most, len(level)), 9)[:, None].astype(np.int16)
        columns = {name: (getattr(level, name) // unit * unit).astype(np.int16) for name in ("feature", "offset")}
        levels.append(replace(level, **columns, scaling=level.scaling // unit * unit))
    scene = replace(scene, levels=tuple(levels))
    return [key(scene), packet(scene, move(scene))]


def _count(count: int) -> Scene:
    scene = small((max(count, 1),), seed=5)
    level = scene.levels[0]
    if count == 0:
        return replace(scene, levels=(empty_level(2, 1),))
    rows = np.arange(count)
    voxel = np.stack([rows >> 4, rows >> 2 & 3, rows & 3], axis=1).astype(np.int32) - 2
    picked = {
        name: np.resize(getattr(level, name), (count, *getattr(level, name).shape[1:])) for name in level.__slots__
    }
    return replace(scene, levels=(type(level)(**{**picked, "voxel": voxel}),))


def _growth(profile: int) -> list[bytes]:
    scene = small()
    packets = [key(scene, profile)]
    for seed in range(3):
        following = grow(replace(move(scene, seed), version=scene.version), seed)
        packets.append(packet(scene, following, profile=profile))
        scene = following
    return packets


def _skip(profile: int) -> list[bytes]:
    first = small()
    second = grow(move(first, 1))
    third = grow(move(second, 2))
    return [key(first, profile), packet(first, third, profile)]


def _extremes(profile: int) -> list[bytes]:
    scene = small((12,))
    level = scene.levels[0]
    high16, low16, high32, low32 = 32767, -32768, 2**31 - 1, -(2**31)
    feature, position, voxel = level.feature.copy(), level.position.copy(), level.voxel.copy()
    feature[0], feature[1] = high16, low16
    scene = replace(scene, levels=(replace(level, feature=feature),))
    position[0], position[1] = 2**29, -(2**29)
    latent = level.latent.copy()
    latent[2], latent[3], latent[4, 0] = high16, low16, 17
    second = later(scene, position=position, latent=latent)
    position, latent = position.copy(), latent.copy()
    position[2], position[3] = high32 - 50, low32 + 50
    latent[2], latent[3] = low16, high16
    third = later(second, position=position, latent=latent)
    voxel[-1] = high32  # needs plain geometry
    other = replace(scene, levels=(replace(scene.levels[0], voxel=voxel),), keyframe=9, version=9)
    return [
        key(scene, profile),
        packet(scene, second, profile=profile),
        packet(second, third, profile=profile),
        key(other, profile),
    ]


def _still() -> list[bytes]:
    scene = small()
    return [key(scene), packet(scene, replace(scene, version=1))]


def _steady() -> list[bytes]:
    """Rows that go on as before, slow and very fast ones, over spans of up to more frames than count."""
    scene = small((12, 40))
    slopes = [np.arange(3 * len(level)).reshape(-1, 3) % 23 - 11 for level in scene.levels]
    slopes[1][7] = (1 << 22, -(1 << 22), 3)
    packets = [key(scene)]
    for version in (1, 3, 10, 300, 301):
        levels = [
            replace(level, position=(slope * version // 2).astype(np.int32))
            for level, slope in zip(scene.levels, slopes, strict=True)
        ]
        following = replace(scene, levels=tuple(levels), version=version)
        packets.append(packet(scene, following))
        scene = following
    return packets


def _trickle() -> list[bytes]:
    first = small((4, 12, 30))
    second = move(first, 1)
    third = move(second, 2)
    parts = split_levels(key(first))
    rest = select_levels(packet(first, third), 0b110)
    return [parts[0], packet(first, second), parts[1], packet(second, third), parts[2], rest]


def _levels_apart() -> list[bytes]:
    first = small((4, 12, 30))
    second = move(first, 1)
    return [drop_levels(key(first), 1), *(select_levels(packet(first, second), 1 << n) for n in (1, 0))]


def _state_hash() -> list[bytes]:
    scene = small()
    following = replace(move(scene, 1), version=30)
    final = move(following, 2)
    return [key(scene), packet(scene, following), packet(following, final)]


def _second_keyframe() -> list[bytes]:
    first, second = small(), replace(small(seed=3), keyframe=7, version=7)
    return [key(first), packet(first, move(first)), key(second), packet(second, move(second))]


def _same_voxel() -> list[bytes]:
    scene = small((12,))
    voxel = scene.levels[0].voxel.copy()
    voxel[5] = voxel[4]
    voxel[9] = voxel[4]
    return _chain(replace(scene, levels=(replace(scene.levels[0], voxel=voxel),)), 1, share=1.0)


def _extension() -> list[bytes]:
    scene = small()
    parsed = parse(packet(scene, move(scene, share=0.5)))
    chunks = sorted([*parsed.chunks, make_chunk(1, 13, b"from the future")], key=lambda c: (c.level, c.kind))
    return [key(scene), build(replace(parsed, chunks=tuple(chunks)))]


def _bare() -> list[bytes]:
    scene = small()
    header = replace(scene.header, view_dependent=False, cameras=())
    weights = replace(scene.weights, hidden_weight=scene.weights.hidden_weight[:2].copy())
    return [key(replace(scene, header=header, weights=weights))]


def _padding(profile: int) -> list[bytes]:
    """Rows so alike that their chunks need zeros behind them: all the same, all moving alike, all added, all gone."""
    scene = small((1, 2))
    rows = np.arange(4096)
    voxel = np.stack([rows >> 8, rows >> 4 & 15, rows & 15], axis=1).astype(np.int32)
    alike = {name: np.repeat(getattr(scene.levels[1], name)[:1], 4096, axis=0) for name in AnchorLevel.__slots__}
    full = AnchorLevel(**{**alike, "voxel": voxel})
    scene = replace(scene, levels=(scene.levels[0], full))
    moved = replace(full, position=full.position + np.int32(3))
    more = AnchorLevel(*(np.concatenate([getattr(moved, n), getattr(full, n)]) for n in AnchorLevel.__slots__))
    states = [replace(scene, levels=(scene.levels[0], level), version=n) for n, level in enumerate((full, moved, more))]
    states.append(
        replace(states[2], version=3, levels=(scene.levels[0], replace(more, alive=np.zeros(8192, np.bool_))))
    )
    pairs = itertools.pairwise(states)
    return [key(scene, profile), *(packet(a, b, profile=profile) for a, b in pairs)]


def _deaths(profile: int) -> list[bytes]:
    """A row that changes as it dies, one that changes afterwards, one that is added dead."""
    first = small()
    level = first.levels[0]
    alive, position = level.alive.copy(), level.position.copy()
    alive[1], position[1, 0] = False, position[1, 0] + 5
    second = later(first, alive=alive, position=position)
    position = position.copy()
    position[1, 1] -= 7
    third = later(second, position=position)
    fourth = grow(third, added=1, removed=0)
    alive = fourth.levels[0].alive.copy()
    alive[-1] = False
    fifth = later(fourth, alive=alive)
    ways = ((first, second), (second, third), (third, fifth))
    return [key(first, profile), *(packet(a, b, profile=profile) for a, b in ways)]


def _first_level_empty(profile: int) -> list[bytes]:
    scene = small((4, 20))
    scene = replace(scene, levels=(empty_level(2, 1), scene.levels[1]))
    return [key(scene, profile), packet(scene, grow(scene, removed=0), profile=profile)]


def _another_run() -> list[bytes]:
    """The same keyframe number again, with other content and therefore another identifier."""
    first, second = replace(small(), identifier=1), replace(small(seed=3), identifier=2**64 - 1)
    parts = split_levels(key(second))
    return [key(first), packet(first, move(first)), *parts, packet(second, move(second))]


def _bounds() -> list[bytes]:
    """Header numbers as large and as small as they may be, in a scene of large numbers."""
    scene = small()
    header, one = scene.header, np.ones(1, np.float32)
    camera = replace(
        header.cameras[0],
        name="ä" * 32,
        width=65535,
        height=1,
        intrinsics=np.diag([1e12, 1e-12, 1.0]),
        distortion=np.full(5, -1e12),
    )
    header = replace(
        header,
        octree=Octree(np.array([-1e9, 1e9, 0.0]), 1e9, 2),
        reference_distance=1e-6,
        position_steps=one.repeat(2) * np.float32(1e9),
        feature_steps=one.repeat(2) * np.float32(1e-45),
        offset_steps=one.repeat(3) * np.float32(1e9),
        scaling_steps=one.repeat(6) * np.float32(1e9),
        background=np.array([0, 1, 1], np.float32),
        fps=10000.0,
        cameras=(camera, replace(camera, name="")),
    )
    slow = replace(header, octree=Octree(np.zeros(3), 1e-6, 2), reference_distance=1e9, fps=0.001, cameras=())
    return [key(replace(scene, header=header)), key(replace(scene, header=slow, keyframe=1, version=1))]


def _most() -> list[bytes]:
    """Sixteen levels, sixteen Gaussians an anchor, 64 features, 255 cameras."""
    scene = make_scene((1,) * 16, slots=16, features=64)
    camera = scene.header.cameras[0]
    cameras = tuple(replace(camera, name=str(number)) for number in range(255))
    scene = replace(scene, header=replace(scene.header, cameras=cameras), identifier=2**63)
    return [key(scene), packet(scene, move(scene, share=1.0))]


def _deep() -> list[bytes]:
    scene = small((9,))
    voxel = scene.levels[0].voxel.copy()
    voxel[-1] = voxel.min(axis=0) + (2**21 - 1)
    return [key(replace(scene, levels=(replace(scene.levels[0], voxel=voxel),)))]


def _deflated(level: int, strategy: int) -> list[bytes]:
    """Coding 0 with other deflate streams than this encoder writes."""
    scene = small()

    def again(data: bytes) -> bytes:
        flush = strategy == zlib.Z_FULL_FLUSH
        packer = zlib.compressobj(level, zlib.DEFLATED, -15, strategy=0 if flush else strategy)
        content = zlib.decompress(data[5:], -15)
        body = packer.compress(content[:50]) + (packer.flush(zlib.Z_FULL_FLUSH) if flush else b"")
        return data[:5] + body + packer.compress(content[50:]) + packer.flush()

    found = []
    for data in (key(scene, 0), packet(scene, move(scene, share=0.6), 0)):
        parsed = parse(data)
        chunks = (c if c.kind in (0, 1, 7) else make_chunk(c.level, c.kind, again(c.data)) for c in parsed.chunks)
        found.append(build(replace(parsed, chunks=tuple(chunks))))
    return found


def _nothing() -> list[bytes]:
    """A row that is named as changed, by nothing: accepted, though an encoder leaves it out."""
    scene = small()
    parsed = parse(packet(scene, replace(scene, version=1)))
    chunk = make_chunk(1, ChunkKind.CHANGE, encode_plain(np.array([[2] + [0] * 27])))
    chunks = sorted([*parsed.chunks, chunk], key=lambda c: (c.level, c.kind))
    return [key(scene), build(replace(parsed, chunks=tuple(chunks)))]


_FACTS = Metadata(
    metres_per_unit=0.01,
    up=(0.0, -1.0, 0.25),
    epoch_ns=1_764_000_000_123_456_789,
    title="Dance at the \u00dcbersee-Museum, \u5e55 2",
    licence="CC-BY-4.0",
    original=Original(2.5, (0.5, -0.5, 0.5, 0.5), (500_000.125, -3.0, 4_649_776.5)),
)


def _metadata() -> list[bytes]:
    """All facts, which a change keeps and a keyframe without the chunk ends, until another has it."""
    first = replace(small(), metadata=_FACTS)
    second = replace(small(seed=3), keyframe=7, version=7, identifier=2)
    third = replace(second, keyframe=8, version=8, identifier=3, metadata=_FACTS)
    return [key(first), packet(first, move(first)), key(second), key(third), packet(third, move(third))]


def _exposures() -> list[bytes]:
    """The exposures of a rig of two cameras, of values that float32 has."""
    found = CameraExposure((1.25, 1.0, 0.75), (0.0, -0.125, 0.5)), CameraExposure((0.75, 1.0, 1.25), (0.0, 0.125, -0.5))
    scene = replace(small(), metadata=Metadata(exposures=found))
    return [key(scene), packet(scene, move(scene))]


def _with_metadata(content: bytes) -> list[bytes]:
    """A keyframe with this METADATA chunk, and a change with another, which says nothing."""
    scene, other = small(), encode_metadata(Metadata(title="of a change"))
    packets = [(key(scene), 0, content), (packet(scene, move(scene, share=0.9)), 0, other)]
    result = []
    for data, level, facts in packets:
        parsed = parse(data)
        chunks = sorted([*parsed.chunks, make_chunk(level, METADATA, facts)], key=lambda c: (c.level, c.kind))
        result.append(build(replace(parsed, chunks=tuple(chunks))))
    return result


def _odd_metadata() -> Iterator[tuple[str, bytes]]:
    """Name and content of chunks that are not as they should be: none of them is refused."""

    def field(tag: int, value: bytes) -> bytes:
        return struct.pack("<HH", tag, len(value)) + value

    title, licence = field(4, b"kept"), field(5, b"MIT")
    yield "empty", b""
    yield "unknown-tags", field(0, b"?") + title + field(900, b"") + field(40_000, b"private")
    yield "cut-in-head", title + licence[:3]
    yield "cut-in-value", title + licence[:-1]
    yield "repeated", title + field(4, b"again") + licence
    yield "descending", licence + title
    yield "lengths", field(1, bytes(7)) + field(2, bytes(25)) + field(3, b"") + title + field(6, bytes(63))
    wrong = struct.pack("<d", -1.0), struct.pack("<3d", 0, 0, 0), struct.pack("<8d", 1, 0, 0, 0, 0, 0, 0, 0)
    yield "out-of-bounds", field(1, wrong[0]) + field(2, wrong[1]) + title + field(6, wrong[2])
    dark = struct.pack("<6f", 0, 1, 1, 0, 0, 0)
    yield "no-exposures", title + field(7, dark) + field(8, b"")
    yield "exposures-cut", title + field(7, dark[:23])
    nan = struct.pack("<3d", 1, float("nan"), 0)
    yield "not-finite", field(1, struct.pack("<d", float("inf"))) + field(2, nan) + title
    yield "no-texts", field(4, b"two\nlines") + field(5, b"\xff\xfe")
    yield "empty-text", field(3, struct.pack("<q", -1)) + field(4, b"") + field(5, b"x" * 1025)
    yield "line-separator", field(4, "a\u2028b".encode()) + licence


def _lanes() -> list[bytes]:
    """An added row under one lane in a level whose keyframe took four."""
    scene = small((900,))
    return [key(scene), packet(scene, grow(scene, added=20))]
