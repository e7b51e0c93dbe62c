"""CHANGE: the dynamic set, position and latent differences under rANS. FORMAT.md section 9."""

from __future__ import annotations

import os

import numpy as np

from codec import change_model
from codec.entropy import corrupt, decode_scales, encode_items, encode_scales, scale_of, words_of
from codec.rans import VALUE_LIMIT, Array
from core.anchors import LATENTS, AnchorLevel
from core.arrays import Int32, Int64, UInt8
from core.entropy_model import SCALES

_SCALE_MASK, _NOT_PREDICTED = 127, 128  # of the position scale's byte


def encode(level: AnchorLevel, rows: Int64, position: Int64, latent: Int64) -> bytes | None:
    """The chunk, or None if a number is too large for it; arguments as in `codec.chunks.encode_change`."""
    errors, plain = change_model.position_errors(level.voxel[rows].astype(np.int64), position, _salt()), 0
    if np.log2(1.0 + np.abs(position)).sum() < np.log2(1.0 + np.abs(errors)).sum():
        errors, plain = position, _NOT_PREDICTED
    if max(np.abs(errors).max(initial=0), np.abs(latent).max(initial=0)) >= VALUE_LIMIT:
        return None
    changed, (touched, used) = np.zeros(len(level), np.uint8), history(level)
    changed[rows] = 1
    position_scale = min(scale_of(float(np.abs(errors).mean()) if len(errors) else 0.0), _SCALE_MASK)
    side, scale = encode_scales(latent[latent.any(axis=1)])

    def model_pass(items: Array) -> int:
        count = change_model.rows_items(changed, touched, items, 0)
        count = change_model.positions_items(errors, SCALES[position_scale], items, count)
        return change_model.latents_items(latent, used[rows], scale, items, count)

    lanes, words = encode_items(model_pass, len(level) + 2 * (errors.size + latent.size))
    return bytes([lanes, position_scale | plain]) + side + words


def decode(data: bytes, level: AnchorLevel) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24]; BitstreamError `corrupt_chunk`."""
    if len(data) < 2:
        raise corrupt("a change ends before its position scale")
    scale, at = decode_scales(data, 2, LATENTS)
    predicted = not data[1] & _NOT_PREDICTED
    nodes = np.array(
        level.voxel, np.int32, order="C"
    )  # a plain array, whatever came: another layout would be compiled anew
    sound, rows, position, latent = change_model.decode_change(
        words_of(data, at), data[0], nodes, *history(level), SCALES[data[1] & _SCALE_MASK], predicted, scale, _salt()
    )
    if not sound:
        raise corrupt("an entropy-coded chunk does not end as it must")
    return rows, position.astype(np.int32), latent.astype(np.int32)


def history(level: AnchorLevel) -> tuple[UInt8, UInt8]:
    """[N] 1 for rows that are no longer what they were at the keyframe, and for those whose latents are not.

    They are likelier to change again.
    """
    position, latent = np.array(level.position, np.int32, order="C"), np.array(level.latent, np.int16, order="C")
    used = np.asarray(change_model.rows_with_any(latent), np.uint8)
    return np.asarray(change_model.rows_with_any(position), np.uint8) | used, used


def _salt() -> np.uint64:
    return np.uint64(int.from_bytes(os.urandom(8), "little"))
