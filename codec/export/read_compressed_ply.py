"""Compressed PLY of SuperSplat and PlayCanvas: four words a Gaussian, and bounds for each 256 of them.

Written from the format's description (developer.playcanvas.com, "Compressed PLY"). Files are hostile.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32, Int64
from streamlod.core.errors import InputError
from streamlod.core.initialise.ply_tables import Tables
from streamlod.core.scene.gaussians import GaussianCloud, as_cloud

_CHUNK = 256  # Gaussians
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_PLACE, _SIZE, _COLOUR = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
_THREE = ((21, 11), (11, 10), (0, 11))  # first bit and number of bits of the numbers in a word
_FOUR = ((24, 8), (16, 8), (8, 8), (0, 8))
_TURN = ((20, 10), (10, 10), (0, 10))  # below the two bits that name the largest component
_MAX_LOG = 20.0  # of scales


def is_compressed(tables: Tables) -> bool:
    """Whether the vertices are packed."""
    return _WORDS[0] in _names(tables["vertex"])


def unpacked(path: Path, tables: Tables) -> GaussianCloud:
    """The Gaussians; those with a bound that is not finite are dropped.

    Raises:
        InputError: words or bounds are missing, or are of another kind.
    """
    vertices, chunks = tables["vertex"], tables.get("chunk", np.zeros(0, np.dtype([])))
    missing = [name for name in _WORDS if name not in _names(vertices)]
    missing += [name for axis in (*_PLACE, *_SIZE) for name in _bounds(axis) if name not in _names(chunks)]
    if missing:
        raise InputError(path, f"is a compressed PLY that lacks {', '.join(missing)}")
    if any(vertices.dtype[name].kind not in "iu" for name in _WORDS):
        raise InputError(path, "is a compressed PLY whose words are no integers")
    if len(chunks) * _CHUNK < len(vertices):
        raise InputError(path, f"has {len(vertices)} packed Gaussians, and {len(chunks)} chunks of {_CHUNK}")
    words = {name: vertices[name].astype(np.uint32).astype(np.int64) for name in _WORDS}
    colours = _shares(words["packed_color"], _FOUR)
    with np.errstate(invalid="ignore", over="ignore"):
        means = _between(tables, _PLACE, _shares(words["packed_position"], _THREE))
        sizes = _between(tables, _SIZE, _shares(words["packed_scale"], _THREE))
        parts = (
            means,
            _rotations(words["packed_rotation"]),
            np.exp(np.clip(sizes, -_MAX_LOG, _MAX_LOG)),
            colours[:, 3],
            np.clip(_between(tables, _COLOUR, colours[:, :3]), 0, 1),
        )
    kept = np.logical_and.reduce([np.isfinite(part).reshape(len(part), -1).all(axis=1) for part in parts])
    return as_cloud(*(part[kept] for part in parts))


def _names(table: NDArray[Any]) -> tuple[str, ...]:
    return table.dtype.names or ()


def _bounds(axis: str) -> tuple[str, str]:
    return f"min_{axis}", f"max_{axis}"


def _shares(words: Int64, fields: tuple[tuple[int, int], ...]) -> Float32:
    """[G,F] in [0, 1]: the fields of each word, of the largest that they can be."""
    numbers = [(words >> first & (1 << bits) - 1) / np.float32((1 << bits) - 1) for first, bits in fields]
    return np.stack(numbers, axis=1).astype(np.float32)


def _between(tables: Tables, axes: tuple[str, ...], shares: Float32) -> Float32:
    """[G,A] between the bounds of each Gaussian's chunk; early files have none of colours, which are shares then."""
    chunks = tables["chunk"]
    if any(name not in _names(chunks) for axis in axes for name in _bounds(axis)):
        return shares
    low, high = (np.stack([chunks[_bounds(axis)[n]] for axis in axes], axis=1).astype(np.float32) for n in (0, 1))
    rows = np.arange(len(shares)) // _CHUNK
    return np.asarray(low[rows] + shares * (high - low)[rows], np.float32)


def _rotations(words: Int64) -> Float32:
    """[G,4] w x y z: the index of the largest, the others in order, from -sqrt(1/2) to sqrt(1/2)."""
    others = (_shares(words, _TURN) - 0.5) * np.float32(np.sqrt(2))
    largest = np.sqrt(np.maximum(1 - (others**2).sum(axis=1), 0))
    quaternions = np.zeros((len(words), 4), np.float32)
    for n in range(4):
        rows = words >> 30 == n
        quaternions[rows] = np.insert(others[rows], n, largest[rows], axis=1)
    return quaternions
