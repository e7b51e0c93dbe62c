"""GEOMETRY by octree occupancy. FORMAT.md section 7."""

from __future__ import annotations

from core.arrays import Int32
from core.errors import BitstreamError


def encode(voxel: Int32) -> bytes | None:
    """The chunk, or None if the octree cannot hold these voxels in this order."""
    return None


def decode(data: bytes, most_rows: int) -> Int32:
    """[N,3] voxels of a chunk of coding 1 or 4."""
    raise BitstreamError("unsupported_profile", "octree geometry is not read yet")
