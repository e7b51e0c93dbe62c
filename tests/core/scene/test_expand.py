"""Anchors to Gaussians against the equations written out for one Gaussian at a time, in float64."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import EXTRA_LEVEL_UNIT, anchor_positions, expand, expand_slots
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.scene.octree import Octree
from tests.codec.scenes import make_scene, move

EYE = np.array([0.4, 0.2, -3.5])
SCENE = move(make_scene((6, 20), slots=2, features=3), share=0.6)


def _sigmoid(x: float) -> float:
    return 1 / (1 + math.exp(-x))


def _one_by_one(scene: Scene, eye: Float64) -> list[list[float]]:
    """Rows of mean 3, rotation 4, scale 3, opacity, colour 3; FORMAT.md section 14."""
    h, w, slots = scene.header, scene.weights, scene.header.gaussians_per_anchor
    found = []
    for number, level in enumerate(scene.levels):
        for i in np.flatnonzero(level.alive):
            latent = level.latent[i].astype(np.float64)
            feature = level.feature[i] * h.feature_steps + latent[:12] @ w.feature_decoder
            offset = (level.offset[i] * h.offset_steps + latent[12:] @ w.offset_decoder).reshape(slots, 3)
            scaling = np.clip(level.scaling[i] * h.scaling_steps, -20, 20)
            anchor = h.octree.origin + level.voxel[i] * h.octree.root_cell / 2**number
            anchor = anchor + level.position[i] * float(h.position_steps[number])
            inputs = feature
            if h.view_dependent:
                away = anchor - eye
                distance = np.linalg.norm(away)
                inputs = np.concatenate([feature, away / distance, [distance / h.reference_distance]])
            hidden = np.maximum(inputs @ w.hidden_weight + w.hidden_bias, 0)
            out = hidden @ w.output_weight + w.output_bias
            for k in range(slots):
                opacity = math.tanh(out[k])
                if opacity > 0:
                    colour = [_sigmoid(x) for x in out[slots + 3 * k :][:3]]
                    scale = [math.exp(scaling[3 + a]) * _sigmoid(out[4 * slots + 3 * k + a]) for a in range(3)]
                    rotation = out[7 * slots + 4 * k :][:4] + np.array([1, 0, 0, 0])
                    mean = anchor + offset[k] * np.exp(scaling[:3])
                    found.append([*mean, *rotation, *scale, opacity, *colour])
    return found


@pytest.mark.parametrize("view_dependent", [True, False])
def test_equations(view_dependent: bool) -> None:
    weights = SCENE.weights if view_dependent else replace(SCENE.weights, hidden_weight=SCENE.weights.hidden_weight[:3])
    scene = replace(SCENE, header=replace(SCENE.header, view_dependent=view_dependent), weights=weights)
    cloud = expand(scene, EYE)
    expected = np.array(_one_by_one(scene, EYE))
    parts = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities[:, None], cloud.colours)
    found = np.concatenate(parts, axis=1)
    assert found.shape == expected.shape
    assert len(found) > 5
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-4)


def test_removed_anchors_vanish() -> None:
    dead = replace(SCENE, levels=tuple(replace(level, alive=np.zeros(len(level), bool)) for level in SCENE.levels))
    assert len(expand(dead, EYE)) == 0


def test_levels_add_up() -> None:
    coarse = expand(SCENE, EYE, highest_level=0)
    everything = expand(SCENE, EYE)
    np.testing.assert_array_equal(everything.means[: len(coarse)], coarse.means)
    assert len(expand(SCENE, EYE, highest_level=9)) == len(everything) > len(coarse)


def test_far_anchors_are_drawn_coarsely() -> None:
    far = np.array([0.0, 0.0, -1000.0])
    only_coarse = expand(SCENE, far, by_distance=True)
    np.testing.assert_array_equal(only_coarse.means, expand(SCENE, far, highest_level=0).means)
    raised = tuple(
        replace(level, extra_level=np.full(len(level), 20 / EXTRA_LEVEL_UNIT, np.int16)) for level in SCENE.levels
    )
    assert len(expand(replace(SCENE, levels=raised), far, by_distance=True)) == len(expand(SCENE, far))


def test_an_eye_on_an_anchor_gives_finite_numbers() -> None:
    eye = anchor_positions(SCENE.header, 0, SCENE.levels[0])[2].astype(np.float64)
    cloud = expand(SCENE, eye)
    assert all(np.isfinite(getattr(cloud, name)).all() for name in cloud.__slots__)


def test_huge_scalings_stay_finite() -> None:
    level = SCENE.levels[0]
    huge = replace(level, scaling=np.full_like(level.scaling, 32767))
    cloud = expand(replace(SCENE, levels=(huge, SCENE.levels[1])), EYE)
    assert np.isfinite(cloud.means).all()
    assert np.isfinite(cloud.scales).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"octree": Octree(np.full(3, 1e308), 1e300, 2)},
        {"position_steps": np.full(2, 3e38, np.float32)},
        {"offset_steps": np.full(6, 3e38, np.float32)},
        {"feature_steps": np.full(3, 3e38, np.float32)},
        {"reference_distance": 1e-300},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_a_gaussian_with_a_number_that_is_not_finite_does_not_exist(wrong: dict[str, Any]) -> None:
    """Headers that no bitstream can hold; what is left is finite, and there is less of it than of the sound scene."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        cloud = expand(replace(SCENE, header=replace(SCENE.header, **wrong)), EYE)
    for part in (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours):
        assert np.isfinite(part).all()
    assert len(cloud) < len(expand(SCENE, EYE))


@pytest.mark.parametrize("length", [0.0, 1e13])
def test_a_gaussian_without_rotation_does_not_exist(length: float) -> None:
    """The first of two Gaussians an anchor has a quaternion that is 0, or too long to say anything."""
    weights = SCENE.weights
    bias, matrix = np.ones(22, np.float32), np.zeros_like(weights.output_weight)
    bias[14:18] = (length - 1, 0, 0, 0)
    cloud = expand(replace(SCENE, weights=replace(weights, output_weight=matrix, output_bias=bias)), EYE)
    assert len(cloud) == sum(int(level.alive.sum()) for level in SCENE.levels)


def test_the_largest_numbers_of_a_header_stay_finite() -> None:
    """At the bounds of FORMAT.md section 4 and the largest integers and weights, nothing overflows."""
    most = np.float32(65504)
    levels = tuple(
        replace(
            level,
            **{n: np.full_like(getattr(level, n), np.iinfo(getattr(level, n).dtype).max) for n in _NUMBERS},
        )
        for level in SCENE.levels
    )
    header = replace(
        SCENE.header,
        octree=Octree(np.full(3, 1e9), 1e9, 2),
        reference_distance=1e-6,
        position_steps=np.full(2, 1e9, np.float32),
        feature_steps=np.full(3, 1e9, np.float32),
        offset_steps=np.full(6, 1e9, np.float32),
        scaling_steps=np.full(6, 1e9, np.float32),
    )
    weights = replace(SCENE.weights, **{n: np.full_like(getattr(SCENE.weights, n), most) for n in _FACTORS})
    rows = np.arange(len(levels[1]))
    found = expand_slots(header, weights, 1, levels[1], rows, EYE)
    for part in (found.means, found.quaternions, found.scales, found.opacities, found.colours):
        assert np.isfinite(part).all()


_NUMBERS = ("voxel", "position", "feature", "offset", "scaling", "latent")
_FACTORS = ("hidden_weight", "hidden_bias", "output_weight", "output_bias", "feature_decoder", "offset_decoder")


def test_nothing_is_drawn_that_is_far_nearer_than_any_camera() -> None:
    """Within 0.15 of the distance to the nearest camera; from where a camera stands, and without any, all is drawn."""
    alone = replace(SCENE, header=replace(SCENE.header, cameras=()))
    for camera in SCENE.header.cameras:
        np.testing.assert_array_equal(expand(SCENE, camera.centre).means, expand(alone, camera.centre).means)
    hidden = 0
    for middle in expand(alone, EYE).means[::7].astype(np.float64):
        eye = middle + 0.05
        radius = 0.15 * min(np.linalg.norm(camera.centre - eye) for camera in SCENE.header.cameras)
        cloud = expand(alone, eye)
        far = np.linalg.norm(cloud.means - eye, axis=1) >= radius
        hidden += (~far).sum()
        for name in GaussianCloud.__slots__:
            np.testing.assert_array_equal(getattr(expand(SCENE, eye), name), getattr(cloud, name)[far])
    assert hidden > 0
