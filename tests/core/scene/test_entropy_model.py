"""The rate model says what the coder spends."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.codec.coder import column_model
from streamlod.codec.coder.entropy import encode_items
from streamlod.core.scene.entropy_model import (
    BIN_THRESHOLDS,
    BINS,
    MAGNITUDE_UNIT,
    SCALES,
    UNIT_BIN,
    magnitude_bits,
)


def bin_of(magnitude: float) -> int:
    """Bin of an expected magnitude |v|, as the coder finds it."""
    return int(np.searchsorted(BIN_THRESHOLDS, int(magnitude * MAGNITUDE_UNIT), side="right"))


def test_bins_are_quarter_octaves() -> None:
    assert [bin_of(2.0**k) for k in (-3, -2, -1, 0, 1)] == [12, 16, 20, UNIT_BIN, 28]
    assert bin_of(0.0) == 0
    assert bin_of(1e9) == BINS - 1


def test_every_bin_prefers_its_own_magnitude() -> None:
    """Values of expected magnitude m are cheapest, within a bin, in the bin of m."""
    rng = np.random.default_rng(0)
    table = magnitude_bits(200)
    for scale in (0.2, 0.5, 1.0, 2.0):
        values = np.abs(np.trunc(rng.laplace(0, scale, 20000))).astype(int)
        cost = table[:, values].mean(axis=1)
        assert abs(int(np.argmin(cost)) - bin_of(float(values.mean()))) <= 2


@pytest.mark.parametrize("mean", [0.2, 0.5, 1.5])
def test_the_table_matches_coded_bytes(mean: float) -> None:
    """Columns of constant energy: coded length within 8 % of the model, as the context seeks energy where none is."""
    rng = np.random.default_rng(1)
    values = np.round(rng.laplace(0, mean, (4000, 8))).astype(np.int64)
    expected = np.abs(values).mean()
    q = int(np.clip(round(8 * np.log2(expected * 256)), 0, 191))
    scale = np.full(8, SCALES[q])
    _, data = encode_items(lambda items: column_model.columns_items(values, scale, items, 0), values.size)
    model = magnitude_bits(100)[bin_of(float(expected))][np.abs(values)].sum()
    assert len(data) * 8 == pytest.approx(model, rel=0.08)
