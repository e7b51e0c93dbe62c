"""Levels as integer matrices, one row an anchor: channels of BASE and ADDED chunks. FORMAT.md sections 8 and 10."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Int16, Int32, Int64
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.anchors import LATENTS, SCALINGS, AnchorLevel, SceneHeader

_UNSHIFTED = 1 + 3  # extra level and position
_INT16 = np.iinfo(np.int16)


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
    """The channels of a level, shifted as by `shifted_channels`."""
    return slice(first, first + level.feature.shape[1] + level.offset.shape[1] + SCALINGS)


def base_matrix(level: AnchorLevel) -> Int64:
    """[N,C] what BASE carries of a level."""
    columns = (level.feature, level.offset, level.scaling, level.extra_level[:, None], level.position)
    return np.concatenate([column.astype(np.int64) for column in columns], axis=1)


def added_matrix(level: AnchorLevel) -> Int64:
    """[N,C] what ADDED carries of a level."""
    columns = (level.voxel, base_matrix(level), level.latent, level.alive[:, None])
    return np.concatenate([column.astype(np.int64) for column in columns], axis=1)


def level_from_base(header: SceneHeader, voxel: Int32, matrix: Int32) -> AnchorLevel:
    """Inverse of `base_matrix`; BitstreamError `overflow` for numbers outside their columns' types."""
    features, offsets = len(header.feature_steps), 3 * header.gaussians_per_anchor
    feature, offset, scaling, extra_level, position = np.split(
        matrix, np.cumsum([features, offsets, SCALINGS, 1]), axis=1
    )
    return AnchorLevel(
        voxel=voxel,
        position=position.copy(),
        feature=_int16(feature),
        offset=_int16(offset),
        scaling=_int16(scaling),
        extra_level=_int16(extra_level)[:, 0],
        latent=np.zeros((len(voxel), LATENTS), np.int16),
        alive=np.ones(len(voxel), np.bool_),
    )


def level_from_added(header: SceneHeader, matrix: Int32) -> AnchorLevel:
    """Inverse of `added_matrix`; BitstreamError `overflow` for numbers outside their columns' types."""
    ends = np.cumsum([3, base_channels(header), LATENTS])
    voxel, base, latent, alive = np.split(matrix, ends, axis=1)
    if len(alive) and (alive.min() < 0 or alive.max() > 1):
        raise BitstreamError("overflow", "whether a row is alive is neither 0 nor 1")
    level = level_from_base(header, voxel.copy(), base)
    return replace(level, latent=_int16(latent), alive=alive[:, 0].astype(np.bool_))


def _int16(values: Int32) -> Int16:
    if values.size and (values.min() < _INT16.min or values.max() > _INT16.max):
        raise BitstreamError("overflow", "a number leaves the range of its 16-bit column")
    return values.astype(np.int16, order="C")
