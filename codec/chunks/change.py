"""CHANGE: the dynamic set, position and latent differences under rANS. FORMAT.md section 9."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.codec.coder import change_model
from streamlod.codec.coder.entropy import corrupt, decode_scales, encode_items, encode_scales, scale_of, words_of
from streamlod.codec.coder.rans import MAX_VALUE, Array
from streamlod.core.arrays import Int16, Int32, Int64, UInt8
from streamlod.core.scene.anchors import LATENTS, AnchorLevel
from streamlod.core.scene.entropy_model import MAX_SCALE, SCALES


@dataclass(frozen=True, slots=True)
class Elapsed:
    """Frames from the keyframe to the state before a packet (`age`), and from there to the one after (`span`)."""

    age: int
    span: int


def encode(level: AnchorLevel, rows: Int64, position: Int64, latent: Int64, elapsed: Elapsed) -> bytes | None:
    """The chunk, or None if a number is too large for it; arguments as in `codec.chunks.level.encode_change`."""
    before, latent_before = _plain(level)
    motion = change_model.steady_motion(before, rows, elapsed.age, elapsed.span)
    errors = change_model.position_errors(position, motion)
    if max(np.abs(errors).max(initial=0), np.abs(latent).max(initial=0)) > MAX_VALUE:
        return None
    changed, touched = np.zeros(len(level), np.uint8), history(level)
    changed[rows] = 1
    position_scale = scale_of(float(np.abs(errors).mean()) if len(errors) else 0.0)
    side, scale = encode_scales(latent[latent.any(axis=1)])

    def model_pass(items: Array) -> int:
        count = change_model.rows_items(changed, touched, items, 0)
        count = change_model.positions_items(errors, motion, SCALES[position_scale], items, count)
        return change_model.latents_items(latent, latent_before[rows], scale, items, count)

    lanes, words = encode_items(model_pass, len(level) + 2 * (errors.size + latent.size))
    return bytes([lanes, position_scale]) + side + words


def decode(data: bytes, level: AnchorLevel, elapsed: Elapsed) -> tuple[Int64, Int32, Int32]:
    """Rows [n], position [n,3] and latent [n,24]; BitstreamError `corrupt_chunk`."""
    if len(data) < 2:
        raise corrupt("a change ends before its position scale")
    if data[1] > MAX_SCALE:
        raise corrupt("the position scale lies beyond the table")
    scale, at = decode_scales(data, 2, LATENTS)
    start = int(SCALES[data[1]])
    sound, rows, position, latent = change_model.decode_change(
        words_of(data, at), data[0], *_plain(level), history(level), start, scale, elapsed.age, elapsed.span
    )
    if not sound:
        raise corrupt("an entropy-coded chunk does not end as it must")
    if len(rows) == 0:
        raise corrupt("a change without rows must be left out")
    return rows, position.astype(np.int32), latent.astype(np.int32)


def history(level: AnchorLevel) -> UInt8:
    """[N] 1 for rows that are no longer what they were at the keyframe: they are likelier to change again."""
    position, latent = _plain(level)
    found = change_model.rows_with_any(position) | change_model.rows_with_any(latent)
    return np.asarray(found, np.uint8)


def _plain(level: AnchorLevel) -> tuple[Int32, Int16]:
    """Positions and latents as arrays of one layout; another would be compiled anew."""
    return np.array(level.position, np.int32, order="C"), np.array(level.latent, np.int16, order="C")
