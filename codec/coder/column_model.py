"""Rows of integers whose common scale is the context, as compiled loops. FORMAT.md section 6.3."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamlod.codec.coder.compiled import compiled
from streamlod.codec.coder.rans import (
    MIN_STATE,
    STARTS,
    SYMBOL_OF,
    TOP_BIN,
    Array,
    magnitude_bin,
    put_value,
    take_value,
)
from streamlod.core.scene.entropy_model import ESCAPE, FREQUENCIES

MAX_ENERGY = 65535


@compiled
def channel_weights(scale: Array) -> tuple[Array, Array, Array, int]:
    """Channel bins, weights w and expectations u of channels with `scale` (0 for uncoded ones), and the sum of u."""
    bins, weight, expected = np.zeros_like(scale), np.zeros_like(scale), np.zeros_like(scale)
    for c in range(len(scale)):
        if scale[c]:
            bins[c] = magnitude_bin(scale[c])
            weight[c] = 65536 // (256 + scale[c])
            expected[c] = max(1, (weight[c] * scale[c] + 128) >> 8)
    return bins, weight, expected, expected.sum()


@compiled
def renews(c: int) -> bool:
    """Whether the context is computed anew before channel c: every second one."""
    return c & 1 == 0


@compiled
def row_gain(mean: int, total: int, energy: int, seen: int) -> int:
    """Bins to add to a channel's own: how much the row's channels so far and the rows before exceed their scales."""
    return magnitude_bin(256 * (mean + 2 * energy) // (total + 2 * seen)) - 24


@compiled
def columns_items(values: Array, scale: Array, items: Array, n: int) -> int:
    """Model pass over `values` [rows, C]; appends to `items` at `n`."""
    bins, weight, expected, total = channel_weights(scale)
    if total == 0:
        return n
    mean = total
    for i in range(len(values)):
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if renews(c):
                gain = row_gain(mean, total, energy, seen)
            if scale[c]:
                value = values[i, c]
                n = put_value(items, n, value, bins[c] + gain)
                energy += weight[c] * min(abs(value), MAX_ENERGY)
                seen += expected[c]
        mean += (energy - mean) >> 3
    return n


@compiled
def take_columns(words: Array, x: Array, ctl: Array, values: Array, rows: Array, scale: Array) -> None:
    """Decode the `rows` [n] of `values` [N, C] one after the other."""
    bins, weight, expected, total = channel_weights(scale)
    if total == 0:
        return
    mean, lanes = total, len(x) - 1
    item, at = ctl[0], ctl[1]  # local copies: the common case of `take_value` is written out here for speed
    for i in rows:
        energy, seen, gain = 0, 0, 0
        for c in range(len(scale)):
            if renews(c):
                gain = row_gain(mean, total, energy, seen)
            if scale[c]:
                b = max(bins[c] + gain, 0)
                state = x[item & lanes]
                slot = state & 4095
                z: Any = np.int64(SYMBOL_OF[min(b, TOP_BIN) * 4096 + slot])
                if b <= TOP_BIN and z < ESCAPE:
                    state = FREQUENCIES[b, z] * (state >> 12) + slot - STARTS[b, z]
                    if state < MIN_STATE:
                        if at == len(words):
                            ctl[2] = 1
                            return
                        state = state << 16 | np.int64(words[at])
                        at += 1
                    x[item & lanes] = state
                    item += 1
                    value = -((z + 1) >> 1) if z & 1 else z >> 1
                else:
                    ctl[0], ctl[1] = item, at
                    value = take_value(words, x, ctl, b)
                    item, at = ctl[0], ctl[1]
                values[i, c] = value
                energy += weight[c] * min(abs(value), MAX_ENERGY)
                seen += expected[c]
        mean += (energy - mean) >> 3
        if ctl[2]:
            return
    ctl[0], ctl[1] = item, at
