"""The tiles a picture is rendered in, for those who mask some of them."""

from __future__ import annotations

TILE_WIDTH, TILE_HEIGHT = 32, 16  # pixels


def tile_grid(width: int, height: int) -> tuple[int, int]:
    """Rows and columns of tiles that cover a picture."""
    return -(-height // TILE_HEIGHT), -(-width // TILE_WIDTH)
