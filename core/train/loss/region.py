"""Which boxes of a picture the loss looks at, when only some tiles change."""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH, Box

_REACH = 10  # pixels around a box that its loss reads: the windows of pixels whose windows touch it
_MAX_BOXES = 64  # boxes that are worth looking at one by one


def loss_boxes(tile_mask: Bool, camera: Camera) -> tuple[Box, ...]:
    """Boxes that hold all tiles of the mask, at least a tile apart, so that no pixel's SSIM counts for two of them.

    Two are made one where that is less work: a box costs its area and a margin of ten pixels.
    """
    count, _, statistics, _ = cv2.connectedComponentsWithStats(tile_mask.astype(np.uint8), connectivity=8)
    boxes = [_box(row) for row in statistics[1:count, : cv2.CC_STAT_AREA].tolist()]
    if len(boxes) > _MAX_BOXES:
        boxes = [_around(*boxes)]
    while (pair := next((p for p in combinations(boxes, 2) if _belong_together(*p)), None)) is not None:
        boxes = [box for box in boxes if box not in pair] + [_around(*pair)]
    right, bottom = camera.width, camera.height
    return tuple(sorted(box._replace(right=min(box.right, right), bottom=min(box.bottom, bottom)) for box in boxes))


def _box(tiles: list[int]) -> Box:
    left, top, width, height = tiles
    right, bottom = left + width, top + height
    return Box(left * TILE_WIDTH, top * TILE_HEIGHT, right * TILE_WIDTH, bottom * TILE_HEIGHT)


def _around(*boxes: Box) -> Box:
    lefts, tops, rights, bottoms = zip(*boxes, strict=True)
    return Box(min(lefts), min(tops), max(rights), max(bottoms))


def _belong_together(a: Box, b: Box) -> bool:
    beside = max(a.left, b.left) - min(a.right, b.right)
    below = max(a.top, b.top) - min(a.bottom, b.bottom)
    return max(beside, below) <= 0 or _cost(_around(a, b)) <= _cost(a) + _cost(b)


def _cost(box: Box) -> int:
    return (box.right - box.left + 2 * _REACH) * (box.bottom - box.top + 2 * _REACH)
