"""The tool that fits the frozen tables finds what it says."""

from __future__ import annotations

import numpy as np

from tests.bench.codec_tables import bits, fitted, law, learned, whole


def test_no_group_is_sacrificed_for_another() -> None:
    """Of two groups, one of smaller numbers in each bin and a hundred times longer, both end at the same excess."""
    groups = [1e6 * law(), 1e4 * np.roll(law(), -3, axis=0)]
    groups[1][-3:] = groups[1][-4]

    def excess(tables: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> list[float]:
        return [bits(group, tables) / bits(group, learned(group)) - 1 for group in groups]

    common = excess(fitted(groups))
    others = [excess(learned(groups[1]))[0], excess(learned(groups[0]))[1]]
    assert abs(common[0] - common[1]) < 0.1 * max(common)
    assert max(common) < 0.5 * min(others)


def test_frequencies_are_as_the_format_wants_them() -> None:
    tables = whole(law())
    assert (tables.sum(axis=1) == 4096).all()
    assert tables.min() >= 1
    assert (np.diff(tables[:, 0]) < 0).all()
    np.testing.assert_array_equal(tables[:, 1:15:2], tables[:, 2:16:2])
