"""Grid geometry and Morton order against slow references."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.scene.octree import MAX_LEVELS, Octree, level_for_distance, morton_key

coordinates = st.lists(st.tuples(*[st.integers(-(2**19), 2**19)] * 3), min_size=1, max_size=40)


def _interleave(x: int, y: int, z: int) -> int:
    return sum((x >> i & 1) << 3 * i + 2 | (y >> i & 1) << 3 * i + 1 | (z >> i & 1) << 3 * i for i in range(21))


@given(coordinates)
def test_morton_keys_interleave_bits(voxels: list[tuple[int, int, int]]) -> None:
    array = np.array(voxels, np.int32)
    low = array.min(axis=0)
    expected = [_interleave(*(int(c) for c in voxel - low)) for voxel in array]
    assert morton_key(array).tolist() == expected


@pytest.mark.parametrize(("levels", "width"), [(1, 8.0), (2, 8.0), (3, 8.0), (4, 4.0), (6, 1.0)])
def test_motion_is_measured_in_cells_of_the_third_finest_level(levels: int, width: float) -> None:
    assert Octree(np.zeros(3), 8.0, levels).motion_cell == width


def test_morton_order_of_a_cube() -> None:
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.int32)
    assert morton_key(cube).tolist() == list(range(8))
    assert morton_key(cube[:0]).tolist() == []


def test_morton_keys_reach_their_last_bit_and_no_further() -> None:
    far = np.array([[0, 0, 0], [2**21 - 1] * 3], np.int32)
    assert morton_key(far)[1] == 2**63 - 1
    with pytest.raises(ValueError, match="span"):
        morton_key(np.array([[-1, 0, 0], [2**21 - 1, 0, 0]], np.int32))


@settings(max_examples=50)
@given(st.integers(0, MAX_LEVELS - 1), st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_nodes_are_the_nearest(level: int, point: list[float]) -> None:
    octree = Octree(np.array([0.3, -1.0, 7.0]), 0.8, MAX_LEVELS)
    position = np.array([point])
    voxel = octree.voxel_of(position, level)
    node = octree.node_of(voxel, level)
    assert np.abs(node - position).max() <= octree.cell(level) * 0.5001
    np.testing.assert_array_equal(octree.voxel_of(node, level), voxel)


def test_a_level_halves_the_cell() -> None:
    octree = Octree(np.zeros(3), 1.5, 5)
    assert [octree.cell(level) for level in range(5)] == [1.5 / 2**level for level in range(5)]


@pytest.mark.parametrize(
    ("origin", "cell", "levels"),
    [
        ([0, 0, np.nan], 1.0, 3),
        ([0, 0, 0], 0.0, 3),
        ([0, 0, 0], math.inf, 3),
        ([0, 0, 0], 1.0, 0),
        ([0, 0, 0], 1.0, 17),
    ],
)
def test_refusals(origin: list[float], cell: float, levels: int) -> None:
    with pytest.raises(ValueError, match="octree"):
        Octree(np.array(origin, np.float64), cell, levels)


def test_near_anchors_get_fine_levels() -> None:
    distance = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 100.0])
    wanted = level_for_distance(distance, 8.0, np.zeros(7), 4)
    assert wanted.tolist() == [4, 4, 3, 2, 1, 0, 0]
    assert level_for_distance(np.array([2.0]), 8.0, np.array([1.6]), 4).tolist() == [4]
