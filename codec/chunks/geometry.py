"""GEOMETRY by octree occupancy. FORMAT.md section 7."""

from __future__ import annotations

import struct

import numpy as np

from streamlod.codec.chunks.plain import row_count
from streamlod.codec.coder import octree_model
from streamlod.codec.coder.entropy import corrupt, encode_items, words_of
from streamlod.codec.packet.limits import Room
from streamlod.core.arrays import Int32
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.octree import morton_key

_HEAD = struct.Struct("<BIiiiB")
_MAX_DEPTH = 21


def encode(voxel: Int32) -> bytes | None:
    """The chunk of `voxel` [N,3], or None if it is not in Morton order without repetition, or spans too far."""
    minimum = voxel.min(axis=0)
    extent = int((voxel.max(axis=0).astype(np.int64) - minimum).max())
    depth = extent.bit_length()
    if depth > _MAX_DEPTH:
        return None
    keys = morton_key(voxel)
    if (np.diff(keys) <= 0).any():
        return None
    lanes, words = encode_items(lambda items: octree_model.octree_items(keys, depth, items, 0), 16 * len(keys))
    return _HEAD.pack(lanes, len(voxel), *minimum.tolist(), depth) + words


def table_columns(depth: int) -> int:
    """The share of a leaf in the bound on rows: one node has to be decoded at each depth."""
    return max(3, depth)


def depth_of(data: bytes) -> int:
    """Depth of the octree of a chunk of coding 1 or 4."""
    return data[_HEAD.size - 1]


def decode(data: bytes, room: Room) -> Int32:
    """[N,3] voxels of a chunk of coding 1 or 4; BitstreamError `corrupt_chunk`, `limit_exceeded` or `overflow`."""
    count = row_count(data)
    if len(data) < _HEAD.size:
        raise corrupt("octree geometry ends before its depth")
    lanes, _, *minimum, depth = _HEAD.unpack_from(data)
    if depth > _MAX_DEPTH:
        raise corrupt(f"an octree cannot be {depth} levels deep")
    room.check_added(count, table_columns(depth))
    sound, nodes = octree_model.decode_octree(words_of(data, _HEAD.size), lanes, depth, count)
    if not sound:
        raise corrupt("octree geometry does not end as it must")
    if nodes.min(axis=0).any() or int(nodes.max()).bit_length() != depth:
        raise corrupt("octree geometry is not in the smallest cube at its minimum")
    voxel = nodes + np.array(minimum, np.int64)
    if voxel.max() > np.iinfo(np.int32).max:
        raise BitstreamError("overflow", "a voxel leaves the range of int32")
    return voxel.astype(np.int32)
