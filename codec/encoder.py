"""Scenes and residuals to packets."""

from __future__ import annotations

import struct

import numpy as np

from codec.chunks import level as chunks
from codec.chunks.change import Elapsed
from codec.chunks.header import encode_header, encode_weights
from codec.packet.bytes import build
from codec.packet.packet import Chunk, ChunkKind, Packet, PacketKind, make_chunk
from core.scene.anchors import AnchorLevel, Scene
from core.scene.residual import LevelResidual, Residual, apply_level

HASH_INTERVAL = 30  # frames between state hashes in predicted packets


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
            parts.append(make_chunk(number, ChunkKind.GEOMETRY, chunks.encode_geometry(level, profile)))
            parts.append(make_chunk(number, ChunkKind.BASE, chunks.encode_base(level, profile)))
    return _packet(
        PacketKind.KEY, profile, scene.version, scene.version, scene.version, time_ns, len(scene.levels), parts
    )


def encode_residual(before: Scene, residual: Residual, *, kind: PacketKind, time_ns: int, profile: int = 1) -> bytes:
    """The packet that turns `before` into the state after `residual`.

    Args:
        kind: predicted, skip or catch-up.
        time_ns: presentation time in nanoseconds of the state after.
        profile: as for `encode_keyframe`.

    Raises:
        ValueError: the residual does not fit `before`, or `kind` does not fit its versions.
    """
    if (residual.keyframe, residual.from_version) != (before.keyframe, before.version):
        raise ValueError(f"a residual from version {residual.from_version} does not fit version {before.version}")
    if kind is PacketKind.KEY:
        raise ValueError("a residual cannot become a key packet")
    age = residual.to_version - residual.keyframe
    hashed = kind is not PacketKind.PREDICTED or age % HASH_INTERVAL == 0
    elapsed = Elapsed(residual.from_version - residual.keyframe, residual.to_version - residual.from_version)
    parts: list[Chunk] = []
    for number, (level, change) in enumerate(zip(before.levels, residual.levels, strict=True)):
        parts += _level_chunks(number, level, change, elapsed, profile)
        if hashed:
            digest = apply_level(level, change).digest()
            parts.append(make_chunk(number, ChunkKind.HASH, struct.pack("<I", digest)))
    versions = (residual.keyframe, residual.from_version, residual.to_version)
    return _packet(kind, profile, *versions, time_ns, len(before.levels), parts)


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


def _packet(
    kind: PacketKind, profile: int, keyframe: int, start: int, end: int, time_ns: int, levels: int, parts: list[Chunk]
) -> bytes:
    return build(Packet(kind, profile, keyframe, start, end, time_ns, (1 << levels) - 1, tuple(parts)))
