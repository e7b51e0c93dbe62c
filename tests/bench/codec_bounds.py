"""How far the coder of latents is from bounds, and from general compressors; part of `codec_bench`."""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from streamlod.codec.coder import change_model, column_model, rans
from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.entropy import encode_scales
from streamlod.core.arrays import Float64, Int16, Int32, Int64
from streamlod.core.scene.anchors import LATENTS, Scene
from streamlod.core.scene.entropy_model import BINS
from streamlod.core.scene.residual import Residual

_LZMA = [{"id": lzma.FILTER_LZMA1, "preset": 9, "lc": 0}]
_CLIP = 64  # magnitudes beyond are counted as this one


def item_bits(items: Int64) -> float:
    """Code length of a list of items."""
    return float(-np.log2((items & 0xFFFF) / 4096).sum())


def latents_bits(latent: Int64, past: Int16) -> tuple[float, float]:
    """Bits of the latent differences [n,24] of changed rows, and of side fields alone; `past` [n,24] latents before."""
    side, scale = encode_scales(latent[latent.any(axis=1)])
    items = np.empty(200 + 20 * latent.size, np.uint32)
    count = change_model.latents_items(latent, past, scale, items, 0)
    return item_bits(items[:count].astype(np.int64)) + 8 * len(side), 8 * len(side)


def latents_report(states: list[Scene], residuals: list[Residual]) -> None:
    """Latents alone: our bits, entropy bounds, general compressors."""
    ours = side = count = 0.0
    compressors = _compressors()
    general = dict.fromkeys(compressors, 0)
    histogram = np.zeros((LATENTS, 2 * _CLIP + 1))
    flags = np.zeros((2, _FLAG_CONTEXTS, 2))
    by_bin = np.zeros((2, BINS + 1, 2 * _CLIP + 1))
    by_context = np.zeros((2, _CONTEXTS, 2 * _CLIP + 1))
    for frame, (state, residual) in enumerate(zip(states, residuals, strict=False)):
        for before, level in zip(state.levels, residual.levels, strict=True):
            latent = np.clip(level.latent.astype(np.int64), -_CLIP, _CLIP)
            if len(latent) == 0:
                continue
            past, half = before.latent[level.rows], frame % 2
            bits, fields = latents_bits(latent, past)
            ours, side = ours + bits, side + fields
            some = np.asarray(latent.any(axis=1), np.bool_)
            np.add.at(flags[half], (_flag_contexts(some, past.any(axis=1), level.position), some.astype(np.int64)), 1)
            values, position = latent[some], level.position[some].astype(np.int64)
            bins = np.empty_like(values)
            _context_bins(values, encode_scales(values)[1], bins)
            np.add.at(by_bin[half], (np.minimum(bins, BINS - 1), values + _CLIP), 1)
            if len(values):
                np.add.at(by_context[half], (_rich_contexts(values, position, past[some]), values + _CLIP), 1)
            np.add.at(histogram, (np.broadcast_to(np.arange(LATENTS), latent.shape), latent + _CLIP), 1)
            count += latent.size
            columns = latent.astype(np.int8).T.tobytes()
            for name, compress in compressors.items():
                general[name] += len(compress(columns))
    rows = {
        "ours, side fields included": ours,
        "ours, contexts and tables alone": ours - side,
        "bound: richer contexts, tables learned on other frames": _held_out(flags) + _held_out(by_context),
        "bound: our contexts, tables learned on other frames": _held_out(flags) + _held_out(by_bin),
        "order-0 a channel, no side information": _entropy(histogram),
        **{name: 8.0 * size for name, size in general.items()},
    }
    print(f"latents: {count / len(residuals):.0f} symbols a frame")
    for name, total in rows.items():
        print(f"  {total / max(count, 1):.4f} bit/symbol, {100 * (total / max(ours, 1) - 1):+6.1f} %  {name}")


@compiled
def _context_bins(values: Int64, scale: Int64, bins_out: Int64) -> None:
    """The bin under which each latent is coded, -1 for uncoded channels."""
    bins, weight, expected, total = column_model.channel_weights(scale)
    mean = total
    for i in range(len(values)):
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if column_model.renews(c) and total:
                gain = column_model.row_gain(mean, total, energy, seen)
            bins_out[i, c] = min(max(bins[c] + gain, 0), rans.TOP_BIN) if scale[c] else -1
            energy += weight[c] * min(abs(values[i, c]), 65535)
            seen += expected[c]
        mean += (energy - mean) >> 3


_CONTEXTS = 7 * 8 * 3 * 2 * 3
_FLAG_CONTEXTS = 2 * 2 * 4


def _flag_contexts(some: NDArray[np.bool_], used: NDArray[np.bool_], position: Int32) -> Int64:
    """[n] a context of whether a row has latents: the row before, its past, its motion."""
    before = np.concatenate([[False], some[:-1]]).astype(np.int64)
    motion = np.minimum(np.ceil(np.log2(1 + np.abs(position).sum(axis=1))).astype(np.int64), 3)
    return np.asarray((2 * before + used) * 4 + motion, np.int64)


def _rich_contexts(latent: Int64, position: Int64, past: Int16) -> Int64:
    """[n,C] a context of the row so far, the rows before, the anchor's motion, the channel's half, and its past."""
    size = np.minimum(np.abs(latent), 6)
    so_far = np.cumsum(size, axis=1) - size
    sofar_class = np.minimum(4 * so_far // (np.arange(LATENTS) + 1), 6)
    total = size.sum(axis=1)
    before = np.zeros(len(latent))
    mean = float(total.mean())
    for row, value in enumerate(total):
        before[row], mean = mean, mean + (float(value) - mean) / 8
    before_class = np.minimum((2 * np.log2(1 + before)).astype(np.int64), 7)
    motion = np.minimum(np.ceil(np.log2(1 + np.abs(position).sum(axis=1))).astype(np.int64), 2)
    half = np.arange(LATENTS) // (LATENTS // 2)
    context = ((sofar_class * 8 + before_class[:, None]) * 3 + motion[:, None]) * 2 + half
    return np.asarray(context * 3 + np.minimum(np.abs(past.astype(np.int64)), 2), np.int64)


def _held_out(counts: Float64) -> float:
    """Bits of each half of the frames ([2,contexts,symbols]) under tables learned on the other half."""
    bits = 0.0
    for train, test in ((0, 1), (1, 0)):
        prior = counts[train].sum(axis=0) + 1e-3
        learned = counts[train] + 2 * prior / prior.sum()
        bits -= float((counts[test] * np.log2(learned / learned.sum(axis=1, keepdims=True))).sum())
    return bits


def _entropy(counts: Float64) -> float:
    """Bits of all symbols at their empirical frequencies, a row a distribution."""
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return float(-(counts * np.log2(np.where(counts > 0, share, 1))).sum())


def _compressors() -> dict[str, Callable[[bytes], bytes]]:
    """General compressors; zstd where its package is installed."""
    found: dict[str, Callable[[bytes], bytes]] = {
        "lzma -9e": lambda data: lzma.compress(data, lzma.FORMAT_RAW, filters=_LZMA),
        "deflate -9": lambda data: zlib.compress(data, 9),
    }
    with suppress(ImportError):
        import zstandard

        found["zstd -19, a level and frame"] = zstandard.ZstdCompressor(level=19).compress
    return found
