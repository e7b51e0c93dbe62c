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
    Positions, scalings, header and weights stay. `keyframe_error` measures the rounding.
    """
    levels = tuple(_fresh(scene.header, scene.weights, level) for level in scene.levels)
    return replace(scene, levels=levels, keyframe=version, version=version, identifier=new_identifier())


def keyframe_error(before: Scene, after: Scene) -> tuple[float, float]:
    """Largest change of a feature and of an offset between a scene and the same scene as a keyframe, in their steps.

    At most half of the multiple that the anchor is rounded to, unless a value left the range of int16.
    """
    feature_error = offset_error = 0.0
    for old, new in zip(before.levels, after.levels, strict=True):
        rows = _order(old)
        feature, offset, _ = dequantise(before.header, before.weights, old, rows)
        new_feature, new_offset, _ = dequantise(after.header, after.weights, new, np.arange(len(new)))
        feature_change = np.abs(new_feature - feature) / before.header.feature_steps
        offset_change = np.abs(new_offset - offset).reshape(len(rows), old.offset.shape[1]) / before.header.offset_steps
        feature_error = max(feature_error, float(feature_change.max(initial=0)))
        offset_error = max(offset_error, float(offset_change.max(initial=0)))
    return feature_error, offset_error


def _fresh(header: SceneHeader, weights: AnchorWeights, level: AnchorLevel) -> AnchorLevel:
    rows = _order(level)
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


def _order(level: AnchorLevel) -> Int64:
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
