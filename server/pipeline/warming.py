"""Compiling the codec's kernels before the first viewer needs them."""

from __future__ import annotations

import numpy as np

from codec.decoder import SceneDecoder
from codec.encoder import encode_keyframe, encode_residual
from core.scene.anchors import HIDDEN, LATENTS, OUTPUTS, SCALINGS, AnchorLevel, AnchorWeights, Scene, SceneHeader
from core.scene.octree import Octree
from core.scene.residual import LevelResidual, Residual, apply

_ANCHORS = 64


def warm_codec() -> None:
    """Encode and decode a scene of a few anchors: half a minute once a machine, then under a second."""
    scene, decoder = _scene(), SceneDecoder()
    decoder.push(encode_keyframe(scene, time_ns=0))
    rows = np.arange(0, _ANCHORS, 2)
    ones = np.ones((len(rows), 3), np.int32), np.ones((len(rows), LATENTS), np.int32)
    level = scene.levels[0]
    added = AnchorLevel(*(getattr(level, name)[:3] for name in AnchorLevel.__slots__))
    residual = Residual(0, 0, 1, (LevelResidual(rows, *ones, rows[:2], added),))
    decoder.push(encode_residual(scene, residual, time_ns=1))
    assert decoder.scene is not None
    assert decoder.scene.levels[0].digest() == apply(scene, residual).levels[0].digest()


def _scene() -> Scene:
    steps = np.ones(1, np.float32)
    octree = Octree(np.zeros(3), 1.0, 1)
    header = SceneHeader(
        octree, 1, False, 1.0, steps, steps.repeat(4), steps.repeat(3), steps.repeat(SCALINGS), np.zeros(3, np.float32),
        30.0, (),
    )  # fmt: skip
    shapes = ((4, HIDDEN), (HIDDEN,), (HIDDEN, OUTPUTS), (OUTPUTS,), (12, 4), (12, 3))
    weights = AnchorWeights(*(np.zeros(shape, np.float32) for shape in shapes))
    axis = np.arange(_ANCHORS, dtype=np.int32)
    voxel = np.stack([axis // 16, axis // 4 % 4, axis % 4], axis=1).astype(np.int32)
    feature, offset, scaling = (np.tile(axis[:, None].astype(np.int16), (1, width)) for width in (4, 3, SCALINGS))
    level = AnchorLevel(
        voxel, voxel * 0, feature, offset, scaling, axis.astype(np.int16), np.zeros((_ANCHORS, LATENTS), np.int16),
        np.ones(_ANCHORS, np.bool_),
    )  # fmt: skip
    return Scene(header, weights, (level,), 0, 0)
