"""Between chunks and the compiled coder: items to words, words out of chunks, and the scales (side fields)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from streamlod.codec.coder.rans import Array, rans_encode
from streamlod.core.arrays import Float64, Int64
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.entropy_model import MAGNITUDE_UNIT, MAX_SCALE, SCALES

FEW_ITEMS = 8000  # below, one lane saves 12 bytes that matter more than speed
_STEPS = 4  # of a scale, between neighbouring nibbles: half an octave
_NIBBLES = 15
_SHARED_MARK = 192  # from here on the first byte is one scale for all channels
_SHARED_FIRST, _SHARED_LAST = 16, 79


def corrupt(detail: str) -> BitstreamError:
    """The refusal of a chunk whose content is not what its coding says."""
    return BitstreamError("corrupt_chunk", detail)


def encode_items(model_pass: Callable[[Array], int], expected: int) -> tuple[int, bytes]:
    """Lanes and words of the items that `model_pass` lists; `expected` is an estimate of their number."""
    size = expected + 64
    while True:
        items = np.empty(size, np.uint32)
        count = model_pass(items)
        if count <= size:
            break
        size *= 2
    lanes = 1 if count < FEW_ITEMS else 4
    words = np.empty(count + 2 * lanes, np.uint16)
    first = rans_encode(items, count, lanes, words)
    return lanes, words[first:].astype("<u2").tobytes()


def words_of(data: bytes, at: int) -> Array:
    """The words of a chunk from byte `at` to its end."""
    if len(data) < at or (len(data) - at) % 2:
        raise corrupt("a chunk's entropy-coded words are cut")
    return np.frombuffer(data, "<u2", offset=at).astype(np.uint16)


def scale_of(mean: float) -> int:
    """Index into SCALES of a mean magnitude."""
    return int(_scale_indices(np.array([mean]))[0])


def _scale_indices(means: Float64) -> Int64:
    index = np.round(8 * np.log2(np.maximum(means, 1e-9) * MAGNITUDE_UNIT))
    return np.asarray(np.clip(index, 0, MAX_SCALE), np.int64)


def encode_scales(values: Array) -> tuple[bytes, Int64]:
    """Side fields of FORMAT.md section 6.3 for `values` [rows, C], and each channel's scale in 1/256.

    Where channels differ little or rows are few, all channels share one scale.
    """
    means = np.abs(values).mean(axis=0) if len(values) else np.zeros(values.shape[1])
    wanted = _scale_indices(means)
    base = int(wanted[means > 0].min(initial=MAX_SCALE))
    base = max(base, int(wanted.max(initial=0)) - _STEPS * (_NIBBLES - 1), 0)
    nibbles = np.minimum((np.maximum(wanted - base, 0) + _STEPS // 2) // _STEPS, (MAX_SCALE - base) // _STEPS) + 1
    nibbles = np.where(means > 0, np.minimum(nibbles, _NIBBLES), 0)
    apart = _scales(base, nibbles)
    shared_index = int(np.clip(scale_of(float(means.mean())), _SHARED_FIRST, _SHARED_LAST))
    shared = np.full(len(means), SCALES[shared_index])
    if len(values) * (_row_bits(means, shared) - _row_bits(means, apart)) < 4 * len(means):
        return bytes([_SHARED_MARK + shared_index - _SHARED_FIRST]), shared
    padded = np.append(nibbles, [0] * (len(nibbles) % 2)).astype(np.uint8)
    return bytes([base]) + bytes((padded[0::2] | padded[1::2] << 4).tolist()), apart


def decode_scales(data: bytes, at: int, channels: int) -> tuple[Int64, int]:
    """Each channel's scale in 1/256, and where the side fields end."""
    if len(data) > at and data[at] >= _SHARED_MARK:
        return np.full(channels, SCALES[data[at] - _SHARED_MARK + _SHARED_FIRST]), at + 1
    end = at + 1 + (channels + 1) // 2
    if len(data) < end:
        raise corrupt("a chunk ends inside its scales")
    packed = np.frombuffer(data, np.uint8, (channels + 1) // 2, at + 1)
    nibbles = np.stack([packed & 15, packed >> 4], axis=1).reshape(-1).astype(np.int64)
    if nibbles[channels:].any():
        raise corrupt("an unused half byte of the scales is not zero")
    nibbles = nibbles[:channels]
    if nibbles.any() and data[at] + _STEPS * (int(nibbles.max()) - 1) > MAX_SCALE:
        raise corrupt("a scale lies beyond the table")
    return _scales(data[at], nibbles), end


def _row_bits(means: Array, scale: Int64) -> float:
    """About the bits of a row whose channels have mean magnitudes `means`, coded with `scale` (0: not coded)."""
    expected = np.maximum(scale / MAGNITUDE_UNIT, 1 / 64)
    bits = np.log2(1 + expected) + means * np.log2(1 + 1 / expected)
    return float(bits[scale > 0].sum())


def _scales(base: int, nibbles: Int64) -> Int64:
    index = np.minimum(base + _STEPS * np.maximum(nibbles - 1, 0), MAX_SCALE)
    return np.where(nibbles > 0, SCALES[index], 0).astype(np.int64)
