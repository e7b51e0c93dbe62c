"""The compiled coder and the plain Python one produce the same words and read each other's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.codec.coder import change_model, class_model, column_model, octree_model, rans, trend
from streamlod.codec.coder.entropy import encode_items
from streamlod.core.arrays import Int64
from streamlod.core.scene.entropy_model import FREQUENCIES, SCALES
from tests.codec import oracle
from tests.codec.columns import decode_columns

EXTREME = rans.MAX_VALUE
seeds = st.integers(0, 2**32 - 1)


def _words(data: bytes) -> list[int]:
    return [int(word) for word in np.frombuffer(data, "<u2")]


def _numbers(rng: np.random.Generator, shape: tuple[int, int]) -> Int64:
    """Laplace integers of very different sizes, some of them extreme."""
    values = np.round(rng.laplace(0, 1, shape) * 2.0 ** rng.uniform(-4, 12, shape[1])).astype(np.int64)
    values[rng.random(shape) < 0.02] = EXTREME
    values[rng.random(shape) < 0.02] = -EXTREME
    return values


@settings(max_examples=40, deadline=None)
@given(seed=seeds, rows=st.integers(0, 30), channels=st.integers(1, 40))
def test_columns(seed: int, rows: int, channels: int) -> None:
    rng = np.random.default_rng(seed)
    values = _numbers(rng, (rows, channels))
    scale = np.where(values.any(axis=0), SCALES[rng.integers(0, 192, channels)], 0)
    lanes, data = encode_items(lambda items: column_model.columns_items(values, scale, items, 0), 10)
    encoder = oracle.Encoder()
    oracle.columns(encoder, rows, scale.tolist(), values.tolist())
    assert encoder.words(lanes) == _words(data)
    decoder = oracle.Decoder(_words(data), lanes)
    assert oracle.columns(decoder, rows, scale.tolist(), None) == values.tolist()
    decoder.finish()
    found = np.zeros(values.shape, np.int32)
    assert decode_columns(np.frombuffer(data, "<u2").astype(np.uint16), lanes, found, scale)
    np.testing.assert_array_equal(found, values)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, rows=st.integers(0, 40), channels=st.integers(1, 12), count=st.integers(1, 8))
def test_classes_of_rows(seed: int, rows: int, channels: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    values, of_row = _numbers(rng, (rows, channels)), rng.integers(0, count, rows)
    scales = SCALES[rng.integers(0, 192, (count, channels))]
    lanes, data = encode_items(lambda items: class_model.rows_items(values, of_row, scales, items, 0), 10)
    encoder = oracle.Encoder()
    oracle.classed_columns(encoder, rows, scales.tolist(), (of_row.tolist(), values.tolist()))
    assert encoder.words(lanes) == _words(data)
    decoder = oracle.Decoder(_words(data), lanes)
    assert oracle.classed_columns(decoder, rows, scales.tolist(), None) == values.tolist()
    decoder.finish()
    found, classes = np.zeros(values.shape, np.int32), np.zeros(rows, np.uint8)
    assert class_model.decode_rows(np.frombuffer(data, "<u2").astype(np.uint16), lanes, found, classes, scales)
    np.testing.assert_array_equal(found, values)
    np.testing.assert_array_equal(classes, of_row)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, rows=st.integers(0, 40))
def test_trends(seed: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    shifts = rng.integers(0, 8, rows)
    values = rng.integers(-(2 ** rng.integers(1, 31)), 2**12, rows) >> shifts << shifts
    errors = trend.trend_errors(values, shifts)
    assert oracle.trend(errors.tolist(), shifts.tolist()) == values.tolist()
    numbers = errors.astype(np.int32)[:, None]
    one = np.ones(1, np.int64)
    assert trend.restore(numbers, shifts, one, 2 * one, 0 * one)
    np.testing.assert_array_equal(numbers[:, 0], values)


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(seed=seeds, count=st.integers(0, 300), share=st.floats(0, 1))
def test_changes(seed: int, count: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    changed = (rng.random(count) < share * rng.random()).astype(np.uint8)
    touched = (rng.random(count) < rng.random()).astype(np.uint8)
    before = (rng.laplace(0, 1, (count, 3)) * 2.0 ** rng.uniform(0, 28)).clip(-(2**31), 2**31 - 1).astype(np.int32)
    age, span = int(rng.integers(0, 3) * rng.integers(0, 2**32)), int(rng.integers(1, 2 ** rng.integers(1, 33)))
    rows = np.flatnonzero(changed)
    delta = _numbers(rng, (len(rows), 3)) // 4
    latent = _numbers(rng, (len(rows), 24)) * (rng.random((len(rows), 1)) < rng.random())
    past = np.round(rng.laplace(0, 1, (count, 24)) * 2.0 ** rng.uniform(-4, 13)).clip(-(2**15), 2**15 - 1)
    past = past.astype(np.int16) * (rng.random((count, 1)) < rng.random()).astype(np.int16)
    scale = np.where(latent.any(axis=0), SCALES[rng.integers(0, 192, 24)], 0)
    motion = change_model.steady_motion(before, rows, age, span)
    assert motion.tolist() == oracle.steady_motion(before[rows].tolist(), age, span)
    errors = change_model.position_errors(delta, motion)
    if np.abs(errors).max(initial=0) > rans.MAX_VALUE:
        return  # sent otherwise

    def model_pass(items: rans.Array) -> int:
        n = change_model.rows_items(changed, touched, items, 0)
        n = change_model.positions_items(errors, motion, SCALES[50], items, n)
        return change_model.latents_items(latent, past[rows], scale, items, n)

    lanes, data = encode_items(model_pass, 10)
    encoder = oracle.Encoder()
    oracle.dynamic_set(encoder, touched.tolist(), changed.tolist())
    oracle.positions(encoder, motion.tolist(), int(SCALES[50]), delta.tolist())
    oracle.latents(encoder, past[rows].tolist(), scale.tolist(), latent.tolist())
    assert encoder.words(lanes) == _words(data)
    words = np.frombuffer(data, "<u2").astype(np.uint16)
    side = (SCALES[50], scale, age, span)
    sound, *found = change_model.decode_change(words, lanes, before, past, touched, *side)
    assert sound
    for expected, array in zip((rows, delta, latent), found, strict=True):
        np.testing.assert_array_equal(expected, array)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, count=st.integers(1, 200), depth=st.integers(0, 21))
def test_octrees(seed: int, count: int, depth: int) -> None:
    rng = np.random.default_rng(seed)
    spread = rng.integers(1, depth + 1) if depth else 0
    leaves = np.unique(rng.integers(0, 2**spread, (count, 3)), axis=0)
    keys = np.array([_morton(leaf, depth) for leaf in leaves.tolist()])
    order = np.argsort(keys)
    lanes, data = encode_items(lambda items: octree_model.octree_items(keys[order], depth, items, 0), 10)
    encoder = oracle.Encoder()
    wanted = [tuple(leaf) for leaf in leaves[order].tolist()]
    assert oracle.octree(encoder, depth, len(keys), wanted) == wanted
    assert encoder.words(lanes) == _words(data)
    sound, nodes = octree_model.decode_octree(np.frombuffer(data, "<u2").astype(np.uint16), lanes, depth, len(keys))
    assert sound
    np.testing.assert_array_equal(nodes, leaves[order])


@pytest.mark.parametrize("e", [0, 3, 4, 255, 256, 789, 790, 791, 1579, 1580, 10**6, 2**42])
def test_bins_agree(e: int) -> None:
    assert rans.magnitude_bin(e) == oracle.magnitude_bin(e)


def test_tables_are_what_the_format_says() -> None:
    assert FREQUENCIES.shape == (31, 17)
    assert (FREQUENCIES.sum(axis=1) == 4096).all()
    assert FREQUENCIES.min() >= 1
    costs = FREQUENCIES[:, 0]
    assert (np.diff(costs) < 0).all()  # a greater expected magnitude makes zero rarer


def _morton(leaf: list[int], depth: int) -> int:
    x, y, z = leaf
    return sum((x >> i & 1) << 3 * i + 2 | (y >> i & 1) << 3 * i + 1 | (z >> i & 1) << 3 * i for i in range(depth))
