"""CHANGE: the dynamic set, position and latent differences under rANS. FORMAT.md section 9."""

from __future__ import annotations

from core.arrays import Int32, Int64
from core.errors import BitstreamError


def encode(voxel: Int32, rows: Int64, position: Int64, latent: Int64) -> bytes | None:
    """The chunk, or None if a number is too large for it."""
    return None


def decode(data: bytes, voxel: Int32) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24]."""
    raise BitstreamError("unsupported_profile", "changes are not read yet")
