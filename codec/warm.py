"""Compile the coder before it is needed: about 12 seconds once, then nothing, as Numba keeps the result on disk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.codec.coder.trend import add_trend
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.scene.anchors import (
    FEATURE_LATENTS,
    HIDDEN,
    OFFSET_LATENTS,
    OUTPUTS,
    SCALINGS,
    AnchorWeights,
    Scene,
    SceneHeader,
    empty_level,
)
from streamlod.core.scene.octree import Octree
from streamlod.core.scene.residual import difference


def warm_up() -> None:
    """Encode and decode a scene of eight anchors, so that every compiled loop exists."""
    before = _scene()
    level = before.levels[0]
    moved = replace(level, position=level.position + np.int32(1), latent=level.latent + np.int16(1))
    after = replace(before, levels=(moved,), version=1)
    decoder = SceneDecoder()
    decoder.push(encode_keyframe(before, time_ns=0))
    add_trend(np.zeros(1, np.int64), np.zeros(1, np.int64))  # which these few anchors do not call for
    decoder.push(encode_residual(before, difference(before, after), time_ns=0))


def _scene() -> Scene:
    def one(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return np.ones(count, np.float32)

    octree = Octree(np.zeros(3), 1.0, 1)
    header = SceneHeader(octree, 1, False, 1.0, one(1), one(1), one(3), one(SCALINGS), one(3), 1.0, ())
    shapes = ((1, HIDDEN), (HIDDEN,), (HIDDEN, OUTPUTS), (OUTPUTS,), (FEATURE_LATENTS, 1), (OFFSET_LATENTS, 3))
    weights = AnchorWeights(*(np.zeros(shape, np.float32) for shape in shapes))
    corners = np.indices((2, 2, 2), np.int32).reshape(3, 8).T.copy()
    empty = empty_level(1, 1)
    columns = {n: np.zeros((8, *getattr(empty, n).shape[1:]), getattr(empty, n).dtype) for n in empty.__slots__}
    level = replace(empty, **{**columns, "voxel": corners, "alive": np.ones(8, np.bool_)})
    return Scene(header, weights, (level,), 0, 0)
