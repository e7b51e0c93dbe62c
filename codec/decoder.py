"""Packets to scenes. Any bytes give either a decoded packet or a `BitstreamError`."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np

from streamlod.codec.chunks import level as chunks
from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.chunks.header import decode_header, decode_weights
from streamlod.codec.chunks.metadata import decode_metadata
from streamlod.codec.packet.bytes import parse
from streamlod.codec.packet.info import PacketInfo, describe
from streamlod.codec.packet.limits import DEFAULT_LIMITS, DecoderLimits, Room
from streamlod.codec.packet.packet import METADATA, ChunkKind, Packet, PacketKind
from streamlod.core.arrays import Int32, Int64
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, Scene, SceneHeader, empty_level
from streamlod.core.scene.residual import LevelResidual, apply_level

ABSENT = -1
_HASH = struct.Struct("<I")


class SceneDecoder:
    """Decodes the packets of one stream into its state. FORMAT.md section 3 says what each packet does.

    Attributes:
        scene: the state; its version is the greatest level version. None before the first keyframe.
        versions: of each level, coarse to fine; -1 for a level that has not arrived.
    """

    def __init__(self, limits: DecoderLimits = DEFAULT_LIMITS) -> None:
        self._limits = limits
        self.scene: Scene | None = None
        self.versions: tuple[int, ...] = ()

    @property
    def current_levels(self) -> int:
        """Number of levels at the newest version, from the coarsest up to the first one that is older or absent."""
        lagging = (number for number, held in enumerate(self.versions) if held != max(self.versions))
        return next(lagging, len(self.versions))

    def push(self, packet: bytes) -> PacketInfo:
        """Decode one packet.

        Raises:
            BitstreamError: the packet is refused, for a reason of FORMAT.md section 13; the state is unchanged.
        """
        parsed = parse(packet, self._limits)
        if parsed.kind is PacketKind.KEY:
            self.scene, self.versions = self._decode_key(parsed)
        else:
            self.scene, self.versions = self._decode_residual(parsed)
        return describe(parsed)

    def _decode_key(self, packet: Packet) -> tuple[Scene, tuple[int, ...]]:
        scene, versions = self._key_scene(packet)
        levels, changed = list(scene.levels), list(versions)
        for number in packet.levels:  # the rows that they had leave room for the new ones
            levels[number] = _empty(scene.header)
        for number in packet.levels:
            levels[number] = _decode_key_level(packet, number, scene, self._room(packet, number, levels))
            changed[number] = packet.keyframe
        return replace(scene, levels=tuple(levels), version=max(changed)), tuple(changed)

    def _key_scene(self, packet: Packet) -> tuple[Scene, tuple[int, ...]]:
        """The scene that the key packet's levels go into."""
        header_data, weights_data = packet.chunk(0, ChunkKind.HEADER), packet.chunk(0, ChunkKind.WEIGHTS)
        if header_data is None or weights_data is None:
            return self._held(packet), self.versions
        header = decode_header(header_data, self._limits)
        weights = decode_weights(weights_data, header)
        count = header.octree.levels
        _check_levels(packet, count)
        levels, facts = (_empty(header),) * count, decode_metadata(packet.chunk(0, METADATA) or b"")
        scene = Scene(header, weights, levels, packet.keyframe, packet.keyframe, packet.identifier, facts)
        return scene, (ABSENT,) * count

    def _room(self, packet: Packet, number: int, levels: list[AnchorLevel]) -> Room:
        """The room that is left for the packet's chunks of level `number` beside the rows of `levels`."""
        level = levels[number]
        rows = self._limits.rows(level.row_bytes, level.slots) - sum(map(len, levels))
        return Room(rows, packet.level_bytes(number))

    def _held(self, packet: Packet) -> Scene:
        if self.scene is None:
            raise BitstreamError("no_keyframe", "a packet came before any keyframe; wait for one")
        held = self.scene
        if (packet.keyframe, packet.identifier) != (held.keyframe, held.identifier):
            wanted = f"{packet.keyframe} ({packet.identifier:016x})"
            raise BitstreamError(
                "unknown_keyframe",
                f"the packet needs keyframe {wanted}, held is {held.keyframe} ({held.identifier:016x})",
            )
        _check_levels(packet, len(self.scene.levels))
        return self.scene

    def _decode_residual(self, packet: Packet) -> tuple[Scene, tuple[int, ...]]:
        scene = self._held(packet)
        matching = [number for number in packet.levels if self.versions[number] == packet.from_version]
        if not matching:
            raise BitstreamError(
                "version_mismatch",
                f"the packet starts at version {packet.from_version}, the levels are at {list(self.versions)}",
            )
        levels, versions = list(scene.levels), list(self.versions)
        for number in matching:
            levels[number] = _decode_residual_level(packet, number, scene, self._room(packet, number, levels))
            versions[number] = packet.to_version
        return replace(scene, levels=tuple(levels), version=max(versions)), tuple(versions)


def _empty(header: SceneHeader) -> AnchorLevel:
    return empty_level(len(header.feature_steps), header.gaussians_per_anchor)


def _check_levels(packet: Packet, count: int) -> None:
    if packet.level_mask >> count:
        raise BitstreamError("bad_scene_header", f"level mask {packet.level_mask:#x} goes beyond {count} levels")


def _decode_key_level(packet: Packet, number: int, scene: Scene, room: Room) -> AnchorLevel:
    geometry, base = packet.chunk(number, ChunkKind.GEOMETRY), packet.chunk(number, ChunkKind.BASE)
    level = _empty(scene.header)
    if geometry is not None and base is not None:
        voxel = chunks.decode_geometry(geometry, packet.profile, room)
        level = chunks.decode_base(base, packet.profile, scene.header, voxel, room)
    _check_hash(packet, number, level)
    return level


def _decode_residual_level(packet: Packet, number: int, scene: Scene, room: Room) -> AnchorLevel:
    before, header = scene.levels[number], scene.header
    rows: Int64 = np.zeros(0, np.int64)
    removed = rows
    position: Int32 = np.zeros((0, 3), np.int32)
    latent: Int32 = np.zeros((0, LATENTS), np.int32)
    added = _empty(header)
    if (data := packet.chunk(number, ChunkKind.CHANGE)) is not None:
        elapsed = Elapsed(packet.from_version - packet.keyframe, packet.to_version - packet.from_version)
        rows, position, latent = chunks.decode_change(data, packet.profile, before, elapsed, room)
    if (data := packet.chunk(number, ChunkKind.REMOVED)) is not None:
        removed = chunks.decode_removed(data, packet.profile, before.alive, room)
    if (data := packet.chunk(number, ChunkKind.ADDED)) is not None:
        added = chunks.decode_added(data, packet.profile, header, room)
    try:
        after = apply_level(before, LevelResidual(rows, position, latent, removed, added))
    except ValueError as error:
        raise BitstreamError("overflow", str(error)) from error
    _check_hash(packet, number, after)
    return after


def _check_hash(packet: Packet, number: int, level: AnchorLevel) -> None:
    digest = packet.chunk(number, ChunkKind.HASH)
    if digest is not None and len(digest) != _HASH.size:
        raise BitstreamError("corrupt_chunk", f"a state hash has {_HASH.size} bytes, not {len(digest)}")
    if digest is not None and _HASH.unpack(digest)[0] != level.digest():
        raise BitstreamError("state_mismatch", f"level {number} differs from the sender's; ask for a keyframe")
