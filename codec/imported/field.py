"""Plain Gaussians as a scene: one an anchor, its numbers passed through the network unchanged.

The network's 32 hidden units take the 11 features of an anchor as 11 pairs of opposite sign, so that its outputs are
the features themselves (FORMAT.md section 14). Latents change each feature by whole steps, so that all of a Gaussian
can change from frame to frame, but its size by no more than a factor of 1.9.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamlod.codec.export.ply import unit_quaternions
from streamlod.core.arrays import Float32, Float64, Int32, Int64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.scene.anchors import (
    FEATURE_LATENTS,
    HIDDEN,
    LATENTS,
    OFFSET_LATENTS,
    OUTPUTS,
    SCALINGS,
    AnchorLevel,
    AnchorWeights,
    Scene,
    SceneHeader,
    new_identifier,
)
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.scene.octree import Octree, morton_key

LEVELS = 3
_FEATURES = OUTPUTS  # opacity, colour 3, size 3, rotation 4: what the network gives for one Gaussian
_STEPS = np.array([1 / 64, *[1 / 32] * 3, *[1 / 32] * 3, *[1 / 64] * 4], np.float32)  # exact in float16
_SIZE = slice(4, 7)
_SCALING_STEP = 1 / 64
_CELL_BITS = 18  # positions are multiples of the scene's width / 2^18
_MIN_CELL = 3e-7  # of the finest level, so that those of the coarsest are within the format's bounds
_SHARES = (1 / 16, 1 / 4)  # of the Gaussians, those that show most, are in level 0, and in levels 0 and 1
_MAX_OPACITY = 0.999
_MIN_SCALE, _MAX_SCALE = 1e-8, 1e8
_REACH = 64.0  # how far from the middle a Gaussian is kept, in distances within which nine tenths lie


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Which Gaussian of a cloud is which row.

    Attributes:
        octree: the grid of positions.
        levels: [n] int64 for each level the Gaussians' numbers in the cloud, in Morton order.
    """

    octree: Octree
    levels: tuple[Int64, ...]


def order_of(cloud: GaussianCloud, most: int) -> Order:
    """A place for each of the `most` Gaussians that show most: by opacity and the area of their two longer axes."""
    means = cloud.means.astype(np.float64)
    middle = np.median(means, axis=0)
    reach = max(float(np.quantile(np.abs(means - middle), 0.9)), 1e-6)
    near = (np.abs(means - middle) <= _REACH * reach).all(axis=1)  # a few far away would spoil the grid of all
    sizes = np.sort(cloud.scales.astype(np.float64), axis=1)
    shown = np.where(near, cloud.opacities * sizes[:, 1] * sizes[:, 2], -1.0)
    chosen = np.argsort(-shown, kind="stable")[: min(most, int(near.sum()))]
    low, high = means[chosen].min(axis=0), means[chosen].max(axis=0)
    finest = max(float((high - low).max()) / ((1 << _CELL_BITS) - 1), _MIN_CELL)
    octree = Octree(low, finest * 2 ** (LEVELS - 1), LEVELS)
    ends = [max(1, int(share * len(chosen))) for share in _SHARES]
    parts = np.split(chosen, ends)
    nodes = _nodes(octree, means)
    levels = tuple(part[np.argsort(morton_key(_voxels(nodes[part], n)), kind="stable")] for n, part in enumerate(parts))
    return Order(octree, levels)


def scene_of(cloud: GaussianCloud, order: Order, fps: float, version: int) -> Scene:
    """The keyframe `version` that shows the Gaussians of `order`."""
    features, scaling, nodes = _features(cloud), _scaling(cloud), _nodes(order.octree, cloud.means)
    levels = tuple(_level(n, nodes[rows], features[rows], scaling[rows]) for n, rows in enumerate(order.levels))
    header = SceneHeader(
        octree=order.octree,
        gaussians_per_anchor=1,
        view_dependent=False,
        reference_distance=min(order.octree.root_cell * 2.0 ** (_CELL_BITS + 8), 1e9),  # all levels, wherever one is
        position_steps=np.full(LEVELS, order.octree.cell(LEVELS - 1), np.float32),
        feature_steps=_STEPS,
        offset_steps=np.ones(3, np.float32),
        scaling_steps=np.full(SCALINGS, _SCALING_STEP, np.float32),
        background=np.zeros(3, np.float32),
        fps=fps,
        cameras=_cameras(cloud.means[np.concatenate(order.levels)].astype(np.float64)),
    )
    return Scene(header, _weights(), levels, version, version, new_identifier())


def later(scene: Scene, cloud: GaussianCloud, order: Order, version: int) -> Scene | None:
    """The state `version` under the keyframe of `scene`, whose Gaussians have become those of `cloud`.

    None where a number does not fit, so that a new keyframe is needed.
    """
    nodes, levels = _nodes(order.octree, cloud.means), []
    for n, (level, rows) in enumerate(zip(scene.levels, order.levels, strict=True)):
        features = _features(cloud)[rows]
        with np.errstate(over="ignore"):
            size = cloud.scales[rows] / np.exp(level.scaling[:, 3:] * np.float64(_SCALING_STEP))
        if (size >= 0.95).any() or (size <= 0.05).any():
            return None
        features[:, _SIZE] = np.round(np.log(size / (1 - size)) / _STEPS[_SIZE])
        latent = np.zeros((len(rows), LATENTS), np.int16)
        latent[:, :_FEATURES] = features - level.feature
        levels.append(replace(level, position=_positions(nodes[rows], level.voxel, n), latent=latent))
    return replace(scene, levels=tuple(levels), version=version)


def _level(number: int, nodes: Int64, features: Int64, scaling: Int64) -> AnchorLevel:
    count, voxel = len(nodes), _voxels(nodes, number)
    return AnchorLevel(
        voxel=voxel,
        position=_positions(nodes, voxel, number),
        feature=features.astype(np.int16),
        offset=np.zeros((count, 3), np.int16),
        scaling=scaling.astype(np.int16),
        extra_level=np.zeros(count, np.int16),
        latent=np.zeros((count, LATENTS), np.int16),
        alive=np.ones(count, np.bool_),
    )


def _features(cloud: GaussianCloud) -> Int64:
    """[G,11] in steps: what tanh, the sigmoid, and adding (1, 0, 0, 0) make opacity, colour and rotation."""
    opacity = np.arctanh(np.clip(cloud.opacities.astype(np.float64), 1 / 512, _MAX_OPACITY))[:, None]
    colour = np.clip(cloud.colours.astype(np.float64), 1 / 512, 511 / 512)
    rotation = unit_quaternions(cloud.quaternions).astype(np.float64)
    rotation = np.where(rotation[:, :1] < 0, -rotation, rotation) - np.array([1, 0, 0, 0])
    parts = (opacity, np.log(colour / (1 - colour)), np.zeros((len(cloud), 3)), rotation)
    return np.asarray(np.round(np.concatenate(parts, axis=1) / _STEPS), np.int64)


def _scaling(cloud: GaussianCloud) -> Int64:
    """[G,6] in steps: twice the size, half of which the sigmoid of 0 leaves; three zeros, as there are no offsets."""
    logs = np.log(2 * np.clip(cloud.scales.astype(np.float64), _MIN_SCALE, _MAX_SCALE))
    steps = np.round(logs / _SCALING_STEP).astype(np.int64)
    return np.concatenate([np.zeros_like(steps), steps], axis=1)


def _nodes(octree: Octree, means: Float32 | Float64) -> Int64:
    """Nearest nodes [G,3] of the finest grid; held to what int32 has room for."""
    finest = octree.cell(LEVELS - 1)
    return np.asarray(np.round(np.clip((means - octree.origin) / finest, -(2.0**30), 2.0**30)), np.int64)


def _voxels(nodes: Int64, level: int) -> Int32:
    """The nodes [G,3] of a level nearest to those of the finest."""
    shift = LEVELS - 1 - level
    return ((nodes + ((1 << shift) >> 1)) >> shift).astype(np.int32)


def _positions(nodes: Int64, voxel: Int32, level: int) -> Int32:
    """Steps [G,3] from voxels of a level to nodes of the finest grid, in its cells."""
    return (nodes - (voxel.astype(np.int64) << LEVELS - 1 - level)).astype(np.int32)


def _weights() -> AnchorWeights:
    hidden, output = np.zeros((_FEATURES, HIDDEN), np.float32), np.zeros((HIDDEN, OUTPUTS), np.float32)
    for c in range(_FEATURES):
        hidden[c, 2 * c], hidden[c, 2 * c + 1] = 1, -1
        output[2 * c, c], output[2 * c + 1, c] = 1, -1
    decoder = np.zeros((FEATURE_LATENTS, _FEATURES), np.float32)
    decoder[np.arange(_FEATURES), np.arange(_FEATURES)] = _STEPS
    zeros = (np.zeros(HIDDEN, np.float32), np.zeros(OUTPUTS, np.float32), np.zeros((OFFSET_LATENTS, 3), np.float32))
    return AnchorWeights(hidden, zeros[0], output, zeros[1], decoder, zeros[2])


def _cameras(means: Float64) -> tuple[Camera, ...]:
    """Four places around the scene's middle, twice as far away as nine tenths of it, as nobody filmed it."""
    middle = np.median(means, axis=0)
    radius = max(float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.9)), 1e-6)
    cameras = []
    for number in range(4):
        angle = number * np.pi / 2
        eye = middle + 2 * radius * np.array([np.sin(angle), -0.25, -np.cos(angle)])
        pose = look_at(eye, middle, np.array([0.0, -1.0, 0.0]))
        cameras.append(pinhole(f"view{number}", (1100.0, 1100.0), (640.0, 360.0), (1280, 720), pose))
    return tuple(cameras)
