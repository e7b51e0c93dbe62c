"""Levels as integer matrices, one row an anchor: channels of BASE and ADDED chunks. FORMAT.md sections 8 and 10."""

from __future__ import annotations

import numpy as np

from core.arrays import Int32, Int64
from core.errors import BitstreamError
from core.scene.anchors import LATENTS, SCALINGS, AnchorLevel, SceneHeader

_UNSHIFTED = 1 + 3  # extra level and position
_INT16, _INT32 = np.iinfo(np.int16), np.iinfo(np.int32)


def base_channels(header: SceneHeader) -> int:
    """Channels of BASE: feature, offset, scaling, extra level, position."""
    return len(header.feature_steps) + 3 * header.gaussians_per_anchor + SCALINGS + 1 + 3


def added_channels(header: SceneHeader) -> int:
    """Channels of ADDED: voxel, those of BASE, latent, alive."""
    return 3 + base_channels(header) + LATENTS + 1


def shifted_channels(header: SceneHeader, first: int = 0) -> slice:
    """Channels of features, offsets and scalings in a matrix where those of BASE begin at `first`."""
    return slice(first, first + base_channels(header) - _UNSHIFTED)


def shifted_of(level: AnchorLevel, first: int = 0) -> slice:
    """As `shifted_channels`, for a level."""
    return slice(first, first + level.feature.shape[1] + level.offset.shape[1] + SCALINGS)


def base_matrix(level: AnchorLevel) -> Int64:
    """[N,C] what BASE carries of a level."""
    columns = (level.feature, level.offset, level.scaling, level.extra_level[:, None], level.position)
    return np.concatenate([column.astype(np.int64) for column in columns], axis=1)


def added_matrix(level: AnchorLevel) -> Int64:
    """[N,C] what ADDED carries of a level."""
    columns = (level.voxel, base_matrix(level), level.latent, level.alive[:, None])
    return np.concatenate([column.astype(np.int64) for column in columns], axis=1)


def level_from_base(header: SceneHeader, voxel: Int32, matrix: Int64) -> AnchorLevel:
    """Inverse of `base_matrix`; BitstreamError `overflow` for numbers outside their columns' types."""
    latent, alive = np.zeros((len(voxel), LATENTS), np.int64), np.ones((len(voxel), 1), np.int64)
    return level_from_added(header, np.concatenate([voxel.astype(np.int64), matrix, latent, alive], axis=1))


def level_from_added(header: SceneHeader, matrix: Int64) -> AnchorLevel:
    """Inverse of `added_matrix`; BitstreamError `overflow` for numbers outside their columns' types."""
    features, offsets = len(header.feature_steps), 3 * header.gaussians_per_anchor
    ends = np.cumsum([3, features, offsets, SCALINGS, 1, 3, LATENTS])
    voxel, feature, offset, scaling, extra_level, position, latent, alive = np.split(matrix, ends, axis=1)
    for part in (voxel, position):
        _check_range(part, _INT32.min, _INT32.max)
    for part in (feature, offset, scaling, extra_level, latent):
        _check_range(part, _INT16.min, _INT16.max)
    _check_range(alive, 0, 1)
    return AnchorLevel(
        voxel=voxel.astype(np.int32),
        position=position.astype(np.int32),
        feature=feature.astype(np.int16),
        offset=offset.astype(np.int16),
        scaling=scaling.astype(np.int16),
        extra_level=extra_level[:, 0].astype(np.int16),
        latent=latent.astype(np.int16),
        alive=alive[:, 0].astype(np.bool_),
    )


def _check_range(values: Int64, low: int, high: int) -> None:
    if values.size and (values.min() < low or values.max() > high):
        raise BitstreamError("overflow", f"a number leaves the range {low} to {high} of its column")
