"""Rows of integers under rANS with an energy context. FORMAT.md sections 6.3, 8 and 10."""

from __future__ import annotations

from core.arrays import Int64
from core.errors import BitstreamError


def encode(matrix: Int64, *, with_count: bool = False) -> bytes | None:
    """The chunk, or None if a number is too large for it."""
    return None


def decode(data: bytes, at: int, rows: int, channels: int) -> Int64:
    """[rows, channels] of a chunk whose fields begin at byte `at`."""
    raise BitstreamError("unsupported_profile", "columns are not read yet")


def decode_counted(data: bytes, most_rows: int, channels: int) -> Int64:
    """[n, channels] of a chunk that begins with its row count."""
    raise BitstreamError("unsupported_profile", "columns are not read yet")
