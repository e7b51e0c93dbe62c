"""Scenes and motion made from a seed, shaped like what training produces: a blobby surface, Laplace residuals."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Float64, Int32
from streamlod.core.camera import look_at, pinhole
from streamlod.core.scene.anchors import LATENTS, SCALINGS, AnchorLevel, AnchorWeights, Scene, SceneHeader
from streamlod.core.scene.octree import Octree, morton_key
from streamlod.core.scene.residual import Residual, difference


def make_scene(counts: tuple[int, ...] = (10, 65, 200), seed: int = 0, slots: int = 4, features: int = 32) -> Scene:
    """A fresh keyframe (version 0) with about `counts` anchors on its levels."""
    rng = np.random.default_rng(seed)
    header = make_header(len(counts), slots, features)
    levels = tuple(_level(rng, number, count, header) for number, count in enumerate(counts))
    return Scene(header, make_weights(header, rng), levels, 0, 0)


def make_header(levels: int, slots: int, features: int) -> SceneHeader:
    """A header with two cameras."""
    target, up = np.zeros(3), np.array([0.0, -1.0, 0.0])
    cameras = tuple(
        pinhole(
            f"cam{i:02d}", (500.0, 510.0), (240.0, 135.0), (480, 270), look_at(np.array([i, 0.1, -3.0]), target, up)
        )
        for i in range(2)
    )
    return SceneHeader(
        octree=Octree(np.array([-1.0, 0.5, 2.25]), 0.32, levels),
        gaussians_per_anchor=slots,
        view_dependent=True,
        reference_distance=4.5,
        position_steps=(0.04 / 2.0 ** np.arange(levels)).astype(np.float32),
        feature_steps=np.full(features, 0.05, np.float32),
        offset_steps=np.full(3 * slots, 0.03, np.float32),
        scaling_steps=np.full(SCALINGS, 0.125, np.float32),
        background=np.array([0, 0.5, 1], np.float32),
        fps=30.0,
        cameras=cameras,
    )


def make_weights(header: SceneHeader, rng: np.random.Generator) -> AnchorWeights:
    """Random weights, exact in float16."""
    features, slots = len(header.feature_steps), header.gaussians_per_anchor
    shapes = ((features + 4, 32), (32,), (32, 11 * slots), (11 * slots,), (12, features), (12, 3 * slots))
    return AnchorWeights(*(rng.normal(0, 0.3, shape).astype(np.float16).astype(np.float32) for shape in shapes))


def move(scene: Scene, seed: int = 0, share: float = 0.1, version: int | None = None) -> Scene:
    """A later state: anchors near a random centre move smoothly and change latents."""
    rng = np.random.default_rng([seed, scene.version])
    drift = rng.normal(0, 3, 3)
    levels = tuple(_move_level(rng, level, share, drift) for level in scene.levels)
    return replace(scene, levels=levels, version=scene.version + 1 if version is None else version)


def grow(scene: Scene, seed: int = 0, added: int = 3, removed: int = 2) -> Scene:
    """A later state with anchors added to and removed from every level."""
    rng = np.random.default_rng([seed, scene.version, 7])
    levels = tuple(_grow_level(rng, n, level, scene.header, added, removed) for n, level in enumerate(scene.levels))
    return replace(scene, levels=levels, version=scene.version + 1)


def steps(scene: Scene, count: int, seed: int = 0) -> tuple[list[Scene], list[Residual]]:
    """`count` moves: states (with `scene` first) and the residuals between them."""
    states = [scene]
    for index in range(count):
        states.append(move(states[-1], seed + index))
    return states, [difference(a, b) for a, b in itertools.pairwise(states)]


def assert_same_level(expected: AnchorLevel, found: AnchorLevel) -> None:
    """Equal to the bit, all columns."""
    for name in AnchorLevel.__slots__:
        np.testing.assert_array_equal(getattr(expected, name), getattr(found, name), err_msg=name)


def assert_same_state(expected: Scene, found: Scene | None) -> None:
    """Equal to the bit, all levels, and the same versions."""
    assert found is not None
    assert (expected.keyframe, expected.version) == (found.keyframe, found.version)
    for a, b in zip(expected.levels, found.levels, strict=True):
        assert_same_level(a, b)


def _level(rng: np.random.Generator, number: int, count: int, header: SceneHeader) -> AnchorLevel:
    voxel = _surface(rng, count, 4 * 2**number)
    n, features, offsets = len(voxel), len(header.feature_steps), 3 * header.gaussians_per_anchor
    return AnchorLevel(
        voxel=voxel,
        position=np.round(rng.laplace(0, 1.5, (n, 3))).astype(np.int32),
        feature=_laplace(rng, n, rng.uniform(0.5, 6, features)),
        offset=_laplace(rng, n, rng.uniform(1, 8, offsets)),
        scaling=(_laplace(rng, n, np.full(SCALINGS, 2.0)) - 30).astype(np.int16),
        extra_level=_laplace(rng, n, np.full(1, 4.0))[:, 0],
        latent=np.zeros((n, LATENTS), np.int16),
        alive=np.ones(n, np.bool_),
    )


def _surface(rng: np.random.Generator, count: int, radius: int) -> Int32:
    """Up to `count` distinct voxels near a bumpy sphere, in Morton order."""
    directions = rng.normal(size=(2 * count, 3))
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    bumps = 1 + 0.2 * np.sin(3 * directions[:, :1]) * np.cos(2 * directions[:, 1:2])
    voxel = np.unique(np.round(directions * bumps * radius).astype(np.int32), axis=0)
    voxel = voxel[rng.permutation(len(voxel))[:count]]
    return voxel[np.argsort(morton_key(voxel))]


def _laplace(rng: np.random.Generator, count: int, scales: Float64) -> np.ndarray[tuple[int, int], np.dtype[np.int16]]:
    values = np.round(rng.laplace(0, 1, (count, len(scales))) * scales)
    return np.clip(values, -32768, 32767).astype(np.int16)


def _move_level(rng: np.random.Generator, level: AnchorLevel, share: float, drift: Float64) -> AnchorLevel:
    if len(level) == 0:
        return level
    centre = level.voxel[rng.integers(len(level))]
    distance = np.linalg.norm(level.voxel - centre, axis=1)
    moving = (distance <= np.quantile(distance, share)) & level.alive
    rows = np.flatnonzero(moving)
    position, latent = level.position.copy(), level.latent.copy()
    position[rows] += np.round(drift + rng.laplace(0, 0.5, (len(rows), 3))).astype(np.int32)
    energy = rng.gamma(2, 0.5, (len(rows), 1)) * np.geomspace(0.1, 2, LATENTS)
    latent[rows] += np.trunc(rng.laplace(0, 1, (len(rows), LATENTS)) * energy).astype(np.int16)
    return replace(level, position=position, latent=latent)


def _grow_level(
    rng: np.random.Generator, number: int, level: AnchorLevel, header: SceneHeader, added: int, removed: int
) -> AnchorLevel:
    alive = level.alive.copy()
    alive[rng.permutation(len(level))[:removed]] = False
    fresh = _level(rng, number, added, header)
    fresh = replace(fresh, latent=_laplace(rng, len(fresh), np.full(LATENTS, 0.5)))
    grown = replace(level, alive=alive)
    return AnchorLevel(*(np.concatenate([getattr(grown, n), getattr(fresh, n)]) for n in AnchorLevel.__slots__))
