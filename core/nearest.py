"""The nearest of many times, without a table of all pairs: recordings have tens of thousands of pictures."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float64, Int64


def nearest_of(among: Float64, times: Float64) -> Int64:
    """[N] places in `among` [K], ascending and not empty, of the nearest to each of `times` [N]; of two, the first."""
    after = np.minimum(np.searchsorted(among, times), len(among) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(among[before] - times) <= np.abs(among[after] - times)
    return np.where(closer, before, after).astype(np.int64)
