"""CHANGE: the dynamic set, position and latent differences under rANS. FORMAT.md section 9."""

from __future__ import annotations

import os

import numpy as np

from codec import kernels
from codec.entropy import corrupt, decode_scales, encode_items, encode_scales, scale_of, words_of
from core.anchors import LATENTS
from core.arrays import Int32, Int64
from core.entropy_model import HIGHEST_SCALE, SCALES


def encode(voxel: Int32, rows: Int64, position: Int64, latent: Int64) -> bytes | None:
    """The chunk, or None if a number is too large for it; arguments as in `codec.chunks.encode_change`."""
    errors = kernels.position_errors(voxel[rows].astype(np.int64), position, _salt())
    if max(np.abs(errors).max(initial=0), np.abs(latent).max(initial=0)) >= kernels.VALUE_LIMIT:
        return None
    changed = np.zeros(len(voxel), np.uint8)
    changed[rows] = 1
    position_scale = scale_of(float(np.abs(errors).mean()) if len(errors) else 0.0)
    side, scale = encode_scales(latent)

    def model_pass(items: kernels.Array) -> int:
        count = kernels.rows_items(changed, items, 0)
        count = kernels.positions_items(errors, SCALES[position_scale], items, count)
        return kernels.columns_items(latent, scale, items, count)

    lanes, words = encode_items(model_pass, len(voxel) + 2 * (errors.size + latent.size))
    return bytes([lanes, position_scale]) + side + words


def decode(data: bytes, voxel: Int32) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24]; BitstreamError `corrupt_chunk`."""
    if len(data) < 2 or data[1] > HIGHEST_SCALE:
        raise corrupt("a change has no position scale of the table")
    scale, at = decode_scales(data, 2, LATENTS)
    position_scale = SCALES[data[1]]
    sound, rows, position, latent = kernels.decode_change(
        words_of(data, at), data[0], voxel, position_scale, scale, _salt()
    )
    if not sound:
        raise corrupt("an entropy-coded chunk does not end as it must")
    return rows, position.astype(np.int32), latent.astype(np.int32)


def _salt() -> np.uint64:
    return np.uint64(int.from_bytes(os.urandom(8), "little"))
