"""Scenes and residuals to packets."""

from __future__ import annotations

import struct

import numpy as np

from streamlod.codec.chunks import level as chunks
from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.chunks.header import encode_header, encode_weights
from streamlod.codec.chunks.metadata import encode_metadata
from streamlod.codec.chunks.padding import padded
from streamlod.codec.packet.bytes import build
from streamlod.codec.packet.packet import METADATA, Chunk, ChunkKind, Packet, PacketKind, make_chunk
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.residual import LevelResidual, Residual, apply_level

HASH_INTERVAL = 30  # versions between state hashes in packets from one version to the next


def encode_keyframe(scene: Scene, *, time_ns: int, profile: int = 1) -> bytes:
    """The key packet of a scene; `codec.packet.levels.split_levels` cuts it into one packet for each level.

    Args:
        time_ns: presentation time in nanoseconds.
        profile: 0 for deflate alone, 1 for the entropy coder.

    Raises:
        ValueError: the scene is not a keyframe (`core.scene.keyframe.as_keyframe` makes one), or holds numbers that
            the format cannot hold.
    """
    if scene.version != scene.keyframe:
        raise ValueError(
            f"version {scene.version} of keyframe {scene.keyframe} is no keyframe; make it one with as_keyframe"
        )
    parts = [
        make_chunk(0, ChunkKind.HEADER, encode_header(scene.header)),
        make_chunk(0, ChunkKind.WEIGHTS, encode_weights(scene.weights)),
    ]
    for number, level in enumerate(scene.levels):
        if level.latent.any() or not level.alive.all():
            raise ValueError(f"level {number} has latents or removed anchors; call as_keyframe first")
        if len(level):
            own = [
                make_chunk(number, ChunkKind.GEOMETRY, chunks.encode_geometry(level, profile)),
                make_chunk(number, ChunkKind.BASE, chunks.encode_base(level, profile)),
                _hash_chunk(number, level),
            ]
            parts += padded(own, scene.header, len(level))
    if not scene.metadata.is_empty:
        parts.append(make_chunk(0, METADATA, encode_metadata(scene.metadata)))
        parts.sort(key=lambda chunk: (chunk.level, chunk.kind))
    return _packet(scene, PacketKind.KEY, scene.version, profile, time_ns, parts)


def encode_residual(before: Scene, residual: Residual, *, time_ns: int, profile: int = 1) -> bytes:
    """The packet that turns `before` into the state after `residual`.

    It carries state hashes if it is the first after a keyframe, if it leads over more than one version, and in
    every `HASH_INTERVAL`th version.

    Args:
        time_ns: presentation time in nanoseconds of the state after.
        profile: as for `encode_keyframe`.

    Raises:
        ValueError: the residual does not fit `before`, or leads back in time.
    """
    if (residual.keyframe, residual.from_version) != (before.keyframe, before.version):
        raise ValueError(f"a residual from version {residual.from_version} does not fit version {before.version}")
    elapsed = Elapsed(residual.from_version - residual.keyframe, residual.to_version - residual.from_version)
    hashed = elapsed.age == 0 or elapsed.span > 1 or (elapsed.age + elapsed.span) % HASH_INTERVAL == 0
    parts: list[Chunk] = []
    for number, (level, change) in enumerate(zip(before.levels, residual.levels, strict=True)):
        own = _level_chunks(number, level, change, elapsed, profile)
        if hashed:
            own.append(_hash_chunk(number, apply_level(level, change)))
        parts += padded(own, before.header, len(level))
    return _packet(before, PacketKind.CHANGE, residual.to_version, profile, time_ns, parts)


def _level_chunks(
    number: int, level: AnchorLevel, change: LevelResidual, elapsed: Elapsed, profile: int
) -> list[Chunk]:
    parts = []
    touched = change.position.any(axis=1) | change.latent.any(axis=1)
    rows = change.rows[touched]
    if len(rows):
        if rows[0] < 0 or rows[-1] >= len(level) or (np.diff(rows) <= 0).any():
            raise ValueError(f"residual rows of level {number} must ascend and lie inside the level")
        position, latent = change.position[touched].astype(np.int64), change.latent[touched].astype(np.int64)
        data = chunks.encode_change(level, rows, position, latent, elapsed, profile)
        parts.append(make_chunk(number, ChunkKind.CHANGE, data))
    if len(change.removed):
        parts.append(make_chunk(number, ChunkKind.REMOVED, chunks.encode_removed(change.removed)))
    if len(change.added):
        parts.append(make_chunk(number, ChunkKind.ADDED, chunks.encode_added(change.added, profile)))
    return parts


def _hash_chunk(number: int, level: AnchorLevel) -> Chunk:
    return make_chunk(number, ChunkKind.HASH, struct.pack("<I", level.digest()))


def _packet(before: Scene, kind: PacketKind, to_version: int, profile: int, time_ns: int, parts: list[Chunk]) -> bytes:
    mask, versions = (1 << len(before.levels)) - 1, (before.keyframe, before.version, to_version)
    return build(Packet(kind, profile, *versions, time_ns, mask, before.identifier, tuple(parts)))
