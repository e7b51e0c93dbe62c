"""Kernels by warps of lanes, in random order, give what the reference gives; and what a GPU forbids is noticed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from streamlod.core.render.warp.kernels.lanes import is_first_lane, lanes_sum
from tests.core.render.test_gradients import SCENES
from tests.core.render.warp import test_pictures
from tests.core.train.engine.warp import test_step
from tests.device.lanes import LanesDiverge, on_lanes

pytestmark = pytest.mark.long  # every kernel is compiled twice


@wp.kernel(enable_backward=False, grid_stride=False)
def add_up(values: wp.array[float], totals: wp.array[float], left_out: int) -> None:
    """Sums of 32 numbers each; one thread leaves before."""
    p = wp.tid()
    if p == left_out:
        return
    total = lanes_sum(values[p])
    if is_first_lane():
        totals[p // 32] = total


@wp.kernel(enable_backward=False, grid_stride=False)
def write_all(at: wp.array[int]) -> None:
    """A race: every thread writes its number to one place."""
    at[0] = wp.tid()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where kernels are compiled once for all tests."""
    return tmp_path_factory.mktemp("lanes")


@pytest.fixture
def lanes(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Iterator[dict[str, Any]]:
    with on_lanes(monkeypatch, folder) as compiled:
        yield compiled


@pytest.mark.parametrize("view_dependent", [False, True])
def test_gradients_of_a_step_equal_the_reference(view_dependent: bool, lanes: dict[str, Any]) -> None:
    test_step.test_gradients_of_a_step_equal_the_reference(view_dependent)
    assert len(lanes) == 17


@pytest.mark.parametrize("scene", SCENES)
def test_picture_and_gradients_equal_the_reference(scene: str, lanes: dict[str, Any]) -> None:
    test_pictures.test_picture_and_gradients_equal_the_reference(scene)
    assert len(lanes) == 6


def test_moving_before_still_ones_are_drawn_as_if_sorted_together(lanes: dict[str, Any]) -> None:
    test_pictures.test_moving_before_still_ones_are_drawn_as_if_sorted_together()
    assert len(lanes) == 6


def sums(threads: int, left_out: int = -1) -> Any:
    """Of 0, 1, 2 ..., 32 of them each."""
    totals = wp.zeros(-(-threads // 32), dtype=float, device="cpu")
    values = wp.array(np.arange(threads, dtype=np.float32), dtype=float, device="cpu")
    wp.launch(add_up, dim=threads, inputs=[values, totals, left_out], device="cpu")
    return totals.numpy()


def test_lanes_add_up(lanes: dict[str, Any]) -> None:
    assert sums(96).tolist() == [496, 1520, 2544]


@pytest.mark.parametrize(("threads", "left_out"), [(96, 40), (80, -1)])
def test_lanes_that_do_not_meet_are_noticed(
    threads: int, left_out: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(LanesDiverge, match="add_up"), on_lanes(monkeypatch, tmp_path):
        sums(threads, left_out)


def test_threads_come_in_any_order(lanes: dict[str, Any]) -> None:
    last = set()
    for _ in range(10):
        at = wp.zeros(1, dtype=int, device="cpu")
        wp.launch(write_all, dim=1000, inputs=[at], device="cpu")
        last.add(int(at.numpy()[0]))
    assert len(last) > 5
