"""Any state as a keyframe: it shows the same picture, without removed anchors and accumulated latents."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32, Int16, Int64
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, AnchorWeights, Scene, SceneHeader, new_identifier
from streamlod.core.scene.expand import dequantise
from streamlod.core.scene.octree import morton_key
from streamlod.core.scene.quantise import trailing_zeros

_INT16 = np.iinfo(np.int16)
_COARSEST = 7  # exponent of two; coarser rows count as this


def as_keyframe(scene: Scene, version: int) -> Scene:
    """`scene` as keyframe `version`.

    Removed anchors are left out and the others sorted in Morton order. Latents are added to the base features and
    offsets, which are rounded to multiples of the header's steps, as coarse as the anchor's numbers were before.
    Positions, scalings, header and weights stay.
    """
    levels = tuple(_fresh(scene.header, scene.weights, level) for level in scene.levels)
    return replace(scene, levels=levels, keyframe=version, version=version, identifier=new_identifier())


def _fresh(header: SceneHeader, weights: AnchorWeights, level: AnchorLevel) -> AnchorLevel:
    rows = living_rows(level)
    feature, offset, _ = dequantise(header, weights, level, rows)
    times = np.int64(1) << coarseness(level, rows)[:, None]
    return AnchorLevel(
        voxel=level.voxel[rows],
        position=level.position[rows],
        feature=_round(feature, header.feature_steps, times),
        offset=_round(offset.reshape(len(rows), level.offset.shape[1]), header.offset_steps, times),
        scaling=level.scaling[rows],
        extra_level=level.extra_level[rows],
        latent=np.zeros((len(rows), LATENTS), np.int16),
        alive=np.ones(len(rows), np.bool_),
    )


def living_rows(level: AnchorLevel) -> Int64:
    """Rows of the living anchors in Morton order; anchors on one node keep their order."""
    alive = np.flatnonzero(level.alive)
    return alive[np.argsort(morton_key(level.voxel[alive]), kind="stable")]


def coarseness(level: AnchorLevel, rows: Int64) -> Int64:
    """[n] exponent of the largest power of two that divides all base numbers of a row."""
    numbers = np.concatenate([level.feature[rows], level.offset[rows], level.scaling[rows]], axis=1)
    return np.asarray(np.where(numbers.any(axis=1), trailing_zeros(numbers, _COARSEST), 0), np.int64)


def _round(values: NDArray[Any], steps: Float32, times: Int64) -> Int16:
    """`values` [n,C] in `steps`, as multiples of `times` [n,1]."""
    limits = _INT16.max // times
    return np.asarray(np.clip(np.round(values / (steps * times)), -limits, limits) * times, np.int16)
