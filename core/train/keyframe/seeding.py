"""First anchors from first points: levels, cells, weed-out, initial values (paper section IV-A)."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.spatial import cKDTree

from streamlod.core.arrays import Float32, Float64, Int32
from streamlod.core.camera import Camera
from streamlod.core.errors import ModelError
from streamlod.core.frames import PointCloud
from streamlod.core.scene.anchors import HIDDEN, OUTPUTS, VIEW_INPUTS
from streamlod.core.scene.octree import MAX_LEVELS, Octree, level_for_distance, morton_key
from streamlod.core.train.config import ModelConfig
from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.field import Field

_FAR_QUANTILE, _NEAR_QUANTILE = 0.99, 0.01
_SEED_SHARE = 0.7  # of the most anchors there may be; growing places the rest where they are needed
_ENOUGH = 4_000  # first anchors, from which fewer of them save time
_SAMPLE = 20_000  # points that the distance statistics look at
_FEATURE_SPREAD, _OFFSET_SPREAD = 0.1, 0.3  # offsets of zero would leave the K Gaussians identical
_OPACITY_BIAS = 0.55  # tanh gives 0.5
_QUIET = 0.1  # of the network's random output weights at first: what is drawn is what the points say
_COLOUR_GAIN = 0.5  # of the colour features: finer than 1, as they are rounded to steps of their own
_COLOUR_UNITS = range(8, 14)  # hidden units that hand the colour features on, in pairs for either sign
_DARKEST = 0.02  # and as far from white: logits stay small


def seed_field(
    points: PointCloud, cameras: tuple[Camera, ...], config: ModelConfig, generator: torch.Generator
) -> Field:
    """Anchors at every level for a cloud of first points.

    Raises:
        ModelError: too few points to start from.
    """
    if len(points) < 4:
        raise ModelError(f"only {len(points)} first points: give a points file, more views, or --points random")
    nearest, farthest = distance_bounds(points.positions, cameras)
    derived = max(round(math.log2(farthest / nearest)) + 1, 1) + config.finer_levels
    levels = min(config.levels or derived, MAX_LEVELS)
    focal = float(np.mean([camera.intrinsics[0, 0] for camera in cameras]))
    octree = Octree(
        origin=points.positions.min(axis=0).astype(np.float64),
        root_cell=config.cell_pixels * farthest / focal,
        levels=levels,
    )
    centres = np.stack([camera.centre for camera in cameras])
    voxels = _first_voxels(octree, points.positions, centres, farthest, config)
    voxels = _within_budget(voxels, int(_SEED_SHARE * config.max_anchors))
    voxel = np.concatenate(voxels)
    level = np.repeat(np.arange(levels), [len(part) for part in voxels])
    position = octree.node_of(voxel, level)
    return Field(
        octree=octree,
        reference_distance=farthest,
        view_dependent=config.view_dependent,
        level=torch.from_numpy(level.astype(np.int64)),
        voxel=torch.from_numpy(voxel),
        extra_level=torch.zeros(len(voxel)),
        position=torch.from_numpy(position.astype(np.float32)),
        feature=_first_features(position, points, config.features, generator),
        offset=_OFFSET_SPREAD * torch.randn(len(voxel), config.gaussians_per_anchor, 3, generator=generator),
        scaling=torch.from_numpy(_neighbour_log_distance(position))[:, None].repeat(1, 6),
        network=_first_network(config, generator),
    )


def distance_bounds(positions: Float32, cameras: tuple[Camera, ...]) -> tuple[float, float]:
    """(d_min, d_max): quantiles of the distances from the cameras to the points (docs/method.md, reading 5)."""
    sample = positions[:: max(1, len(positions) // _SAMPLE)].astype(np.float64)
    distances = [np.linalg.norm(sample - camera.centre, axis=1) for camera in cameras]
    farthest = max(float(np.quantile(d, _FAR_QUANTILE)) for d in distances)
    nearest = min(float(np.quantile(d, _NEAR_QUANTILE)) for d in distances)
    return max(nearest, 1e-3 * farthest), farthest


def _first_voxels(
    octree: Octree, positions: Float32, centres: Float64, farthest: float, config: ModelConfig
) -> list[Int32]:
    """[n,3] occupied nodes of each level, no narrower than `first_cell_pixels` unless that leaves few."""
    least = config.finer_levels
    if config.first_cell_pixels > 0:
        least = min(max(math.floor(math.log2(config.cell_pixels / config.first_cell_pixels)), 0), least)
    for finer in range(least, config.finer_levels + 1):
        voxels = [_occupied(octree, positions, level, centres, farthest, finer) for level in range(octree.levels)]
        if sum(map(len, voxels)) >= _ENOUGH:
            break
    return voxels


def _occupied(octree: Octree, positions: Float32, level: int, centres: Float64, farthest: float, finer: int) -> Int32:
    """[n,3] occupied nodes of `level` in Morton order, without those too fine for every camera (weed-out)."""
    voxels = np.unique(octree.voxel_of(positions.astype(np.float64), level), axis=0)
    if level:
        nodes = octree.node_of(voxels, level)
        wanted = [
            level_for_distance(np.linalg.norm(nodes - centre, axis=1), farthest, np.zeros(len(nodes)), octree.levels)
            for centre in centres
        ]
        voxels = voxels[(np.stack(wanted) >= level - finer).any(axis=0)]
    return voxels[np.argsort(morton_key(voxels), kind="stable")]


def _within_budget(voxels: list[Int32], budget: int) -> list[Int32]:
    """Coarse levels first; the level that exceeds the budget is thinned evenly along its Morton order."""
    kept, room = list[Int32](), budget
    for level in voxels:
        count = min(len(level), room)
        kept.append(level[np.linspace(0, len(level) - 1, count).round().astype(np.int64)] if count else level[:0])
        room -= count
    return kept


def _neighbour_log_distance(position: Float64) -> Float32:
    """[N] log of the root mean square distance to the three nearest anchors."""
    count = min(4, len(position))
    distance, _ = cKDTree(position).query(position, k=count)
    rms = np.sqrt(np.maximum((np.reshape(distance, (len(position), count))[:, 1:] ** 2).mean(axis=1), 1e-7))
    return np.asarray(np.log(rms), np.float32)


def _first_features(position: Float64, points: PointCloud, size: int, generator: torch.Generator) -> torch.Tensor:
    """[N,F] small noise, with the logits of the nearest point's colour in the first three channels."""
    feature = _FEATURE_SPREAD * torch.randn(len(position), size, generator=generator)
    _, nearest = cKDTree(points.positions).query(position)
    feature[:, :3] = torch.from_numpy(points.colours[nearest]).clamp(_DARKEST, 1 - _DARKEST).logit() / _COLOUR_GAIN
    return feature


def _first_network(config: ModelConfig, generator: torch.Generator) -> Network:
    """A network that gives every Gaussian the colour in its anchor's features and half opacity.

    A network that starts with wrong colours first learns to hide: within 20 steps it sends half of all opacities below
    zero, where they have no gradient and never come back.
    """
    slots = config.gaussians_per_anchor
    inputs = config.features + (VIEW_INPUTS if config.view_dependent else 0)
    outputs = OUTPUTS * slots

    def uniform(*shape: int, fan_in: int) -> torch.Tensor:
        return (torch.rand(*shape, generator=generator) * 2 - 1) / math.sqrt(fan_in)

    hidden_weight, output_weight = uniform(inputs, HIDDEN, fan_in=inputs), uniform(HIDDEN, outputs, fan_in=HIDDEN)
    hidden_bias, output_bias = uniform(HIDDEN, fan_in=inputs), _QUIET * uniform(outputs, fan_in=HIDDEN)
    output_weight *= _QUIET
    hidden_weight[:3] *= _QUIET
    output_bias[:slots] = _OPACITY_BIAS
    for unit, (channel, sign) in zip(_COLOUR_UNITS, ((c, s) for c in range(3) for s in (1, -1)), strict=True):
        hidden_weight[:, unit], hidden_bias[unit], output_weight[unit] = 0.0, 0.0, 0.0
        hidden_weight[channel, unit] = sign
        output_weight[unit, slots + channel : 4 * slots : 3] = sign * _COLOUR_GAIN
    return Network(hidden_weight, hidden_bias, output_weight, output_bias)
