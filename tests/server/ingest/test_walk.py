"""What a person with a board is told while a rig is recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count

import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.board.description import Board
from streamlod.core.errors import InputError
from streamlod.server.ingest.board_sight import BoardSight
from streamlod.server.ingest.sync.clock import ClockSource
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant
from streamlod.server.ingest.walk import WalkWatch
from tests.core.calibration.filmed import filmed, rays_of
from tests.server.ingest.executors import AtOnce

BOARD, SIZE = Board(), (640, 480)
LENS = np.array([600.0, 600.0, 319.5, 239.5, 0, 0, 0, 0, 0])
GREY = np.full((SIZE[1], SIZE[0], 3), 110, np.uint8)


def seen_at(x: float, y: float) -> UInt8:
    """A picture of the board, held upright about a point in metres beside the axis."""
    turned = np.eye(4)
    turned[:3, 3] = np.array([x, y, 1.1]) - BOARD.centre
    return filmed(rays_of(LENS, SIZE), rigid.pose(turned), SIZE, BOARD)


def damaged() -> UInt8:
    raise InputError("picture", "does not decode")


def told(*loads: Callable[[], UInt8] | None, looks: int) -> list[str]:
    """What is said when the same pictures come so many times, the clock a second on whenever it is read."""
    return told_and_shown(*loads, looks=looks)[0]


def told_and_shown(*loads: Callable[[], UInt8] | None, looks: int) -> tuple[list[str], list[Mapping[str, BoardSight]]]:
    """What is said, and what the cameras' own pages are given."""
    said: list[str] = []
    shown: list[Mapping[str, BoardSight]] = []
    seconds, names = count(), [f"cam{row}" for row in range(len(loads))]
    watch = WalkWatch(names, BOARD, said.append, shown.append, AtOnce(), lambda: float(next(seconds)))
    for number in range(looks):
        pictures = [
            None if load is None else Picture(name, number, ClockSource.ARRIVAL, 0, load)
            for name, load in zip(names, loads, strict=True)
        ]
        watch.look(Instant(number, number, tuple(pictures)))
    watch.end()
    return said, shown


def test_the_part_of_a_picture_that_never_had_the_board_is_told() -> None:
    left = seen_at(-0.25, -0.15)
    (*_, last) = told(lambda: left, lambda: GREY, looks=10)
    assert last == (
        "the board: cam0 needs it in the upper right, lower left and lower right; cam1 has not seen it; "
        "cam1 and another camera need it at one time"
    )


def test_missing_and_damaged_pictures_show_nothing() -> None:
    assert told(None, damaged, looks=10) == ["the board: no camera has seen it, which is to have 7x5 squares of 55 mm"]


def test_a_look_that_breaks_is_logged_once_and_ends_the_watch(caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> UInt8:
        raise RuntimeError("no thread is left")

    assert told_and_shown(broken, looks=10) == ([], [{}])
    (line,) = caplog.records
    assert line.getMessage() == "the board's walk is no longer watched, as a look at the pictures broke"
    assert line.exc_info is not None


def test_each_camera_is_shown_what_it_sees_and_needs_next() -> None:
    left, middle = seen_at(-0.25, -0.15), seen_at(0, 0)
    _, shown = told_and_shown(lambda: left, lambda: middle, lambda: GREY, None, looks=10)
    unseen = BoardSight(seen=False, needs="not seen yet")
    assert shown[0] == {
        "cam0": BoardSight(seen=True, needs="upper left"),
        "cam1": BoardSight(seen=True, needs="upper left"),
        "cam2": unseen,
        "cam3": unseen,
    }
    assert shown[-1] == {
        "cam0": BoardSight(seen=True, needs="upper right"),
        "cam1": BoardSight(seen=True, needs=""),
        "cam2": unseen,
        "cam3": unseen,
    }


def test_enough_is_told() -> None:
    middle = seen_at(0, 0)
    assert told(lambda: middle, lambda: middle, looks=10)[-1] == "the board: all cameras have seen enough of it"
