"""GEOMETRY by octree occupancy. FORMAT.md section 7."""

from __future__ import annotations

import struct

import numpy as np

from codec.coder import octree_model
from codec.coder.entropy import corrupt, encode_items, words_of
from core.arrays import Int32
from core.errors import BitstreamError
from core.scene.octree import morton_key

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


def decode(data: bytes, most_rows: int) -> Int32:
    """[N,3] voxels of a chunk of coding 1 or 4; BitstreamError `corrupt_chunk`, `limit_exceeded` or `overflow`."""
    if len(data) < _HEAD.size:
        raise corrupt("octree geometry ends before its counts")
    lanes, count, *minimum, depth = _HEAD.unpack_from(data)
    if count > most_rows:
        raise BitstreamError("limit_exceeded", f"{count} anchors exceed the limit of {most_rows}")
    if depth > _MAX_DEPTH or count == 0:
        raise corrupt(f"an octree of depth {depth} with {count} leaves cannot be")
    sound, nodes = octree_model.decode_octree(words_of(data, _HEAD.size), lanes, depth, count)
    if not sound:
        raise corrupt("octree geometry does not end as it must")
    voxel = nodes + np.array(minimum, np.int64)
    if voxel.max() > np.iinfo(np.int32).max:
        raise BitstreamError("overflow", "a voxel leaves the range of int32")
    return voxel.astype(np.int32)
