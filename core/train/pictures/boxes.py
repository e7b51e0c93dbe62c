"""The part of a picture that is worth looking at."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH, tile_grid


def around(mask: Tensor, room: int) -> tuple[slice, slice]:
    """Rows and columns of the smallest box that holds the pixels of `mask` [H,W], some at least, and `room` around."""
    sides = []
    for axis in (1, 0):
        inside = torch.nonzero(mask.any(dim=axis))[:, 0]
        sides.append(slice(max(int(inside[0]) - room, 0), int(inside[-1]) + room + 1))
    return sides[0], sides[1]


def tiles_near(mask: Bool, border: int) -> Bool:
    """[tiles_y,tiles_x] bool: tiles with pixels within `border` pixels of those of `mask` [H,W]."""
    height, width = mask.shape
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((2 * border + 1, 2 * border + 1), np.uint8))
    rows, columns = tile_grid(width, height)
    padded = np.zeros((rows * TILE_HEIGHT, columns * TILE_WIDTH), np.bool_)
    padded[:height, :width] = wide
    return np.asarray(padded.reshape(rows, TILE_HEIGHT, columns, TILE_WIDTH).any(axis=(1, 3)))
