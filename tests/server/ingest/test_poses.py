"""Poses of a live rig that do not hold for what is filmed: told at the first instant, and no more once they hold."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.checks.matches import matched
from streamlod.core.data.lens import undistortions
from streamlod.server.ingest.live import open_live
from streamlod.server.ingest.poses import PoseWatch
from tests.core.calibration.checks import room
from tests.core.data.writers import write_video
from tests.server.ingest.executors import AtOnce

RIG = room.cameras(4)
EXCHANGED = "cam_1 and cam_2 are exchanged: swap their names, as each shows what the other's pose sees"
ALL = np.ones(4, np.bool_)


@cache
def _filmed() -> UInt8:
    """Drawn once, by the first test: every process of tests reads this module."""
    return room.frames(RIG, 1)[0].images


def _exchanged(first: int, second: int) -> UInt8:
    order = {first: second, second: first}
    return _filmed()[[order.get(number, number) for number in range(4)]]


def _definition(folder: Path, shown: Sequence[UInt8], fps: int = 30, *, realtime: bool = False) -> dict[str, Any]:
    """A rig of files that show these pictures, one set a frame."""
    cameras = []
    for number, camera in enumerate(RIG):
        file = folder / f"{camera.name}.mp4"
        write_video(file, [images[number] for images in shown], fps=fps, options={"crf": "16"})
        cameras.append(
            {
                "name": camera.name,
                "source": str(file),
                "width": camera.width,
                "height": camera.height,
                "intrinsics": camera.intrinsics.tolist(),
                "world_to_camera": camera.world_to_camera.tolist(),
            }
        )
    return {"fps": fps, "realtime": realtime, "depth_bounds": [0.5, 12], "cameras": cameras}


def test_names_exchanged_are_told_while_the_first_frame_trains(tmp_path: Path) -> None:
    dataset = open_live(_definition(tmp_path, [_exchanged(1, 2)] * 6))
    with closing(dataset.frames()) as frames:
        next(frames)  # and no more, as while a first frame trains
        limit = time.monotonic() + 30
        while (told := dataset.statistics()) is not None and not told.poses:
            assert time.monotonic() < limit
            time.sleep(0.02)
        assert told is not None
        assert told.poses == (EXCHANGED,)


def test_no_scene_is_trained_of_names_exchanged_that_are_swapped_within_a_minute(tmp_path: Path) -> None:
    shown = [_exchanged(1, 2)] * 2 + [_filmed()] * 60
    dataset = open_live(_definition(tmp_path, shown, 2, realtime=True))
    with closing(dataset.frames()) as frames:
        first = next(frames)
        told = dataset.statistics()
    assert told is not None
    assert (first.index, told.delivered, told.poses) == (0, 1, ())
    assert told.dropped_stale > 0
    nearer = [np.abs(first.images.astype(int) - images.astype(int)).mean() for images in (_filmed(), shown[0])]
    assert nearer[0] < nearer[1] / 4, "the first picture to train shows what the poses say"


def test_poses_that_nobody_puts_right_are_trained_with_after_a_minute() -> None:
    watched = _Watched()
    for now in (0.0, 30.0, 59.9):
        watched.now = now
        assert watched.watch.is_to_be_put_right(_exchanged(1, 2), ALL, AtOnce())
    watched.now = 60.0
    assert not watched.watch.is_to_be_put_right(_exchanged(1, 2), ALL, AtOnce())
    assert watched.told == [(EXCHANGED,)] * 3


class _Watched:
    """A watch, what it told by each look, and its clock."""

    def __init__(self) -> None:
        self.now = 0.0
        self.told: list[tuple[str, ...]] = []
        self.watch = PoseWatch(undistortions(RIG, 1), self.told.append, lambda: self.now)

    def look(self, images: UInt8, present: Sequence[bool] | Any = ALL) -> None:
        self.watch.look(images, np.array(present), AtOnce())


def test_poses_that_hold_are_not_complained_of_whatever_the_size() -> None:
    for scale in (0.5, 2):  # other tests have 1
        size = round(480 * scale), round(270 * scale)
        rig = [camera.scaled(*size) for camera in RIG]
        images = np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in _filmed()])
        told: list[tuple[str, ...]] = []
        for pictures in (images, images[[0, 2, 1, 3]]):
            PoseWatch(undistortions(rig, 1), told.append).look(pictures, ALL, AtOnce())
        assert told == [(), (EXCHANGED,)]


def test_a_camera_that_comes_later_is_looked_at_when_it_comes_and_others_as_there_is_time() -> None:
    watched = _Watched()
    watched.look(_exchanged(1, 2), [True, False, True, True])
    assert watched.told[-1] != ()
    watched.look(_exchanged(1, 2))
    assert watched.told[1:] == [(EXCHANGED,)]
    watched.look(_filmed())  # the clock stands, so that looks took no time
    assert watched.told[2:] == [()], "names were swapped"


def test_looking_takes_a_hundredth_of_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = _Watched()

    def slow(*_: Any) -> list[Any]:
        watched.now += 0.5
        return []

    monkeypatch.setattr("streamlod.server.ingest.poses.matched", slow)
    for _ in range(3 * 600):
        watched.look(_filmed())
        watched.now += 1 / 3
    assert len(watched.told) == 12  # ten minutes of 50 seconds between looks, and the first one


def test_looks_are_more_frequent_while_poses_do_not_hold_and_after_a_change_of_hands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watched = _Watched()

    def slow(images: list[UInt8]) -> Any:
        watched.now += 2.0
        return matched(images)

    monkeypatch.setattr("streamlod.server.ingest.poses.matched", slow)
    watched.look(_exchanged(1, 2))
    watched.now += 19
    watched.look(_filmed())
    assert watched.told == [(EXCHANGED,)]
    watched.now += 1
    watched.look(_filmed())
    assert watched.told[1:] == [()]
    watched.now += 197
    watched.look(_filmed())
    assert len(watched.told) == 2, "what holds is looked at seldom"
    watched.watch.look(_exchanged(1, 2), ALL, AtOnce(), (1, 2, 2, 1))
    assert watched.told[2:] == [(EXCHANGED,)], "other phones film as these cameras"


def test_a_look_that_breaks_takes_back_what_was_told(caplog: pytest.LogCaptureFixture) -> None:
    watched = _Watched()
    for images in (_exchanged(0, 3), _filmed()[:, :0], _filmed(), _filmed()):
        watched.look(images)
    assert watched.told[0] != ()
    assert watched.told[-1] == ()
    (record,) = caplog.records
    assert record.getMessage() == "poses are no longer compared with the pictures, as a look at the pictures broke"
