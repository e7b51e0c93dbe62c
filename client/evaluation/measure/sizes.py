"""The cost of a frame: the bytes of its real packet, and the order-0 entropy that papers mostly report beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.packet.info import peek
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.residual import Residual

KEYFRAME_INTERVAL = 100  # predicted frames to a keyframe, where nothing calls for one sooner (`codec.refresh`)


@dataclass(frozen=True, slots=True)
class PacketSize:
    """Bytes of one packet: all of it, and the share of each octree level, coarse first."""

    total_bytes: int
    level_bytes: tuple[int, ...]


def packet_size(before: Scene | None, after: Scene, residual: Residual | None) -> PacketSize:
    """Size of the packet that leads from `before` to `after`; a keyframe's where `before` or `residual` is None."""
    if before is None or residual is None:
        packet = encode_keyframe(after, time_ns=0)
    else:
        packet = encode_residual(before, residual, time_ns=0)
    return PacketSize(len(packet), peek(packet).level_bytes)


def stream_bytes(keyframe_bytes: float, predicted_bytes: float, interval: int = KEYFRAME_INTERVAL) -> float:
    """Bytes a frame of a long stream: every frame is predicted, and every `interval`-th comes as a keyframe as well.

    Args:
        keyframe_bytes: of one keyframe. predicted_bytes: mean of the predicted packets.
    """
    return predicted_bytes + keyframe_bytes / interval


def shannon_keyframe_bytes(scene: Scene) -> float:
    """Zeroth-order entropy of every channel of the anchors, float16 weights as they are.

    Published sizes are often such estimates: no tables, no headers, an ideal coder.
    """
    weights = sum(getattr(scene.weights, name).size for name in type(scene.weights).__slots__) * 16
    return float(weights + sum(_state_bits(level) for level in scene.levels)) / 8


def shannon_residual_bytes(before: Scene, residual: Residual) -> float:
    """Zeroth-order entropy of the changed rows' channels, of the mask that names them, and of the added rows."""
    bits = 0.0
    for level, part in zip(before.levels, residual.levels, strict=True):
        count = int(level.alive.sum())
        bits += _mask_bits(len(part.rows), count) + _mask_bits(len(part.removed), count)
        bits += _column_bits(part.position) + _column_bits(part.latent) + _state_bits(part.added)
    return bits / 8


def _state_bits(level: AnchorLevel) -> float:
    moves = np.diff(level.voxel, axis=0, prepend=np.zeros((1, 3), np.int32)) if len(level) else level.voxel
    parts = (
        moves,
        level.position,
        level.feature,
        level.offset,
        level.scaling,
        level.latent,
        level.extra_level[:, None],
    )
    return sum(_column_bits(part) for part in parts)


def _column_bits(values: NDArray[Any]) -> float:
    """Bits of integers [n,c] under the histogram of each column."""
    return sum(entropy_bits(column) for column in values.T) if len(values) else 0.0


def entropy_bits(values: NDArray[Any]) -> float:
    """n times the entropy of the histogram of `values` [n], in bits."""
    _, counts = np.unique(values, return_counts=True)
    return float(-(counts * np.log2(counts / len(values))).sum()) if len(values) else 0.0


def _mask_bits(chosen: int, of: int) -> float:
    """Bits that say which `chosen` of `of` rows, each independently as likely as its share."""
    if not 0 < chosen < of:
        return 0.0
    share = chosen / of
    return -(chosen * math.log2(share) + (of - chosen) * math.log2(1 - share))
