"""Anchors to Gaussians for one view: the reference arithmetic of the decoder, in numpy.

Every other implementation (training in torch, the browser) is tested against this one. Equations 3
and 7 of the paper; conventions in `core.scene.anchors`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Bool, Float32, Float64, Int64
from streamlod.core.camera import Camera
from streamlod.core.scene.anchors import FEATURE_LATENTS, AnchorLevel, AnchorWeights, Scene, SceneHeader
from streamlod.core.scene.gaussians import MAX_LOG_SCALE, GaussianCloud, as_cloud, concatenate
from streamlod.core.scene.octree import level_for_distance

EXTRA_LEVEL_UNIT = 1 / 64
NEAR_SHARE = 0.15  # of the distance to the nearest camera: what is nearer to a viewer than this is not drawn
_MIN_LENGTH, _MAX_LENGTH = 1e-12, 1e12  # lengths of quaternions that say a rotation


def expand(
    scene: Scene, viewpoint: Float64, highest_level: int | None = None, by_distance: bool = False
) -> GaussianCloud:
    """The Gaussians seen from `viewpoint`, those that `without_near` leaves.

    Args:
        viewpoint: [3] camera centre in world units.
        highest_level: finest level to draw; all levels by default.
        by_distance: also drop levels that are finer than the anchor's distance calls for (paper section IV-A).
    """
    top = len(scene.levels) - 1 if highest_level is None else min(highest_level, len(scene.levels) - 1)
    clouds = []
    for number, level in enumerate(scene.levels[: top + 1]):
        rows = np.flatnonzero(level.alive)
        if by_distance and len(rows):
            positions = anchor_positions(scene.header, number, level)[rows]
            distance = np.linalg.norm(positions.astype(np.float64) - viewpoint, axis=1)
            extra = level.extra_level[rows].astype(np.float64) * EXTRA_LEVEL_UNIT
            wanted = level_for_distance(distance, scene.header.reference_distance, extra, top)
            rows = rows[wanted >= number]
        clouds.append(expand_rows(scene.header, scene.weights, number, level, rows, viewpoint))
    return without_near(concatenate(clouds), scene.header.cameras, viewpoint)


def without_near(cloud: GaussianCloud, cameras: tuple[Camera, ...], viewpoint: Float64) -> GaussianCloud:
    """`cloud` without what is nearer to `viewpoint` [3] than 0.15 of the way from there to the nearest of `cameras`.

    No camera has seen that from so near: for all of them it was small and far away, and may be wrong by more than it
    is wide; for this viewer it would hide the scene. From where a camera stands, nothing is left out.
    """
    radius = near_radius(cameras, viewpoint)
    if radius == 0:
        return cloud
    return _rows_of(cloud, ((cloud.means - viewpoint) ** 2).sum(axis=1) >= radius**2)


def near_radius(cameras: tuple[Camera, ...], viewpoint: Float64) -> float:
    """The distance from `viewpoint` [3] within which nothing is drawn, in world units; 0 without cameras."""
    return NEAR_SHARE * min((float(np.linalg.norm(camera.centre - viewpoint)) for camera in cameras), default=0.0)


def anchor_positions(header: SceneHeader, number: int, level: AnchorLevel) -> Float32:
    """[N,3] float32 world positions of the anchors of level `number`."""
    nodes = header.octree.node_of(level.voxel, number)
    return (nodes + level.position * np.float64(header.position_steps[number])).astype(np.float32)


def dequantise(
    header: SceneHeader, weights: AnchorWeights, level: AnchorLevel, rows: Int64
) -> tuple[Float32, Float32, Float32]:
    """Features [n,F], offsets [n,K,3] and log-scales [n,6] of `rows`, all float32."""
    latent = level.latent[rows].astype(np.float32)
    feature = level.feature[rows] * header.feature_steps + latent[:, :FEATURE_LATENTS] @ weights.feature_decoder
    offset = level.offset[rows] * header.offset_steps + latent[:, FEATURE_LATENTS:] @ weights.offset_decoder
    scaling = np.clip(level.scaling[rows] * header.scaling_steps, -MAX_LOG_SCALE, MAX_LOG_SCALE)
    return feature, offset.reshape(len(rows), header.gaussians_per_anchor, 3), scaling


def expand_rows(
    header: SceneHeader, weights: AnchorWeights, number: int, level: AnchorLevel, rows: Int64, viewpoint: Float64
) -> GaussianCloud:
    """The Gaussians of `rows` of level `number`, those of positive opacity only, in order of row and slot."""
    return visible(expand_slots(header, weights, number, level, rows, viewpoint))


def visible(cloud: GaussianCloud) -> GaussianCloud:
    """The Gaussians of positive opacity."""
    return _rows_of(cloud, cloud.opacities > 0)


def _rows_of(cloud: GaussianCloud, kept: Bool) -> GaussianCloud:
    rows = np.flatnonzero(kept)
    return GaussianCloud(*(getattr(cloud, name)[rows] for name in GaussianCloud.__slots__))


def expand_slots(
    header: SceneHeader, weights: AnchorWeights, number: int, level: AnchorLevel, rows: Int64, viewpoint: Float64
) -> GaussianCloud:
    """All n * K Gaussians of `rows` of level `number`, K to a row; opacity 0 for those that do not exist.

    These are the ones that the network does not want, and those with a number that is not finite or no rotation.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        cloud = _network_outputs(header, weights, number, level, rows, viewpoint)
        length = np.linalg.norm(cloud.quaternions.astype(np.float64), axis=1)
        sums = [part.sum(axis=1, dtype=np.float64) for part in (cloud.means, cloud.scales, cloud.colours)]
    sound = np.isfinite(sum(sums)) & np.isfinite(cloud.opacities) & (length >= _MIN_LENGTH) & (length <= _MAX_LENGTH)
    return cloud if sound.all() else replace(cloud, opacities=np.where(sound, cloud.opacities, np.float32(0)))


def _network_outputs(
    header: SceneHeader, weights: AnchorWeights, number: int, level: AnchorLevel, rows: Int64, viewpoint: Float64
) -> GaussianCloud:
    count, slots = len(rows), header.gaussians_per_anchor
    feature, offset, scaling = dequantise(header, weights, level, rows)
    anchors = anchor_positions(header, number, level)[rows]
    inputs = [feature]
    if header.view_dependent:
        away = anchors - viewpoint.astype(np.float32)
        distance = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.float32(1e-12))
        inputs += [away / distance, distance / np.float32(header.reference_distance)]
    hidden = np.maximum(np.concatenate(inputs, axis=1) @ weights.hidden_weight + weights.hidden_bias, 0)
    outputs = hidden @ weights.output_weight + weights.output_bias
    opacity = np.maximum(np.tanh(outputs[:, :slots]).reshape(-1), 0)
    colour = _sigmoid(outputs[:, slots : 4 * slots]).reshape(-1, 3)
    relative = _sigmoid(outputs[:, 4 * slots : 7 * slots]).reshape(count, slots, 3)
    rotation = outputs[:, 7 * slots :].reshape(-1, 4) + np.array([1, 0, 0, 0], np.float32)
    size = np.exp(scaling)
    means = anchors[:, None] + offset * size[:, None, :3]
    scales = size[:, None, 3:] * relative
    return as_cloud(means.reshape(-1, 3), rotation, scales.reshape(-1, 3), opacity, colour)


def _sigmoid(values: Float32) -> Float32:
    return np.asarray(0.5 * np.tanh(0.5 * values) + 0.5, np.float32)
