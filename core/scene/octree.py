"""The octree's geometry: levels, cells, and Morton order.

Level 0 is the coarsest; a cell of level l is half as wide as one of level l - 1. Anchors sit on grid nodes, which are
integers (docs/method.md, reading 7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, Float64, Int32, Int64, check_array

MAX_LEVELS = 16
_MOTION_LEVELS = 3  # the level whose cells measure motion, counted from the finest one
_MORTON_BITS = 21  # a coordinate takes 21 bits of a 63-bit key
MORTON_REACH = 1 << _MORTON_BITS  # cells along an axis


@dataclass(frozen=True, slots=True, eq=False)
class Octree:
    """Grid geometry shared by all levels.

    Attributes:
        origin: [3] float64 world position of voxel (0, 0, 0) at every level.
        root_cell: width of a level-0 cell in world units.
        levels: number of levels, 1 to 16.
    """

    origin: Float64
    root_cell: float
    levels: int

    def __post_init__(self) -> None:
        check_array("origin", self.origin, (3,), np.float64)
        if not (self.root_cell > 0 and math.isfinite(self.root_cell) and np.isfinite(self.origin).all()):
            raise ValueError("an octree needs a finite origin and a positive, finite root cell")
        if not 1 <= self.levels <= MAX_LEVELS:
            raise ValueError(f"an octree has 1 to {MAX_LEVELS} levels, not {self.levels}")

    def cell(self, level: int) -> float:
        """Width of a cell of `level` in world units: root_cell / 2^level (paper section IV-A)."""
        return self.root_cell / 2.0**level

    @property
    def motion_cell(self) -> float:
        """Width of the cells that motion is measured in where anchors grow in this octree, in world units.

        They are those of the third finest level. The cells of level 0 suit what is farthest: in a garden under a sky, a
        32nd of them is more than a pixel of what moves near the cameras.
        """
        return self.cell(max(self.levels - _MOTION_LEVELS, 0))

    def voxel_of(self, positions: Float32 | Float64, level: int | Int64) -> Int32:
        """[N,3] int32 nearest grid node of world `positions` [N,3], on one level or on [N]; `node_of` goes back."""
        cell = np.reshape(self.root_cell / 2.0 ** np.asarray(level), (-1, 1))
        return np.round((positions - self.origin) / cell).astype(np.int32)

    def node_of(self, voxels: Int32, level: int | Int64) -> Float64:
        """[N,3] float64 world position of grid nodes `voxels` [N,3], of one level or of [N]."""
        return self.origin + voxels * np.reshape(self.root_cell / 2.0 ** np.asarray(level), (-1, 1))


def narrowest_cell(motion_cell: float) -> float:
    """Width of the narrowest cells in which anchors grow where motion is measured in cells of `motion_cell`."""
    return motion_cell / 2.0 ** (_MOTION_LEVELS - 1)


def level_for_distance(distance: Float64, reference_distance: float, extra: Float64, highest: int) -> Int64:
    """Finest level drawn for anchors at `distance` [N] from a camera: round(log2(d_max / d) + extra) in [0, highest].

    Paper section IV-A, read as in docs/method.md, readings 1 to 3: near anchors get high, that is fine, levels.
    """
    with np.errstate(divide="ignore"):
        wanted = np.log2(reference_distance / np.maximum(distance, 1e-12)) + extra
    return np.clip(np.round(wanted), 0, highest).astype(np.int64)


def morton_key(voxels: Int32) -> Int64:
    """[N] int64 Morton (Z-order) keys of `voxels` [N,3] relative to their own minimum.

    Raises:
        ValueError: the voxels span more than 2^21 cells along an axis.
    """
    if len(voxels) == 0:
        return np.zeros(0, np.int64)
    relative = voxels.astype(np.int64) - voxels.min(axis=0).astype(np.int64)
    if relative.max() >= MORTON_REACH:
        raise ValueError(f"voxels span {int(relative.max()) + 1} cells, more than 2^{_MORTON_BITS}")
    spread = _spread_bits(relative)
    return (spread[:, 0] << 2) | (spread[:, 1] << 1) | spread[:, 2]


def _spread_bits(values: Int64) -> Int64:
    """Put two zero bits between the bits of 21-bit integers."""
    values = (values | values << 32) & 0x1F00000000FFFF
    values = (values | values << 16) & 0x1F0000FF0000FF
    values = (values | values << 8) & 0x100F00F00F00F00F
    values = (values | values << 4) & 0x10C30C30C30C30C3
    return (values | values << 2) & 0x1249249249249249
