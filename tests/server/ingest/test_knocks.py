"""A camera that is knocked while a stream trains: named within a few frames, left out, and taken back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.camera import Camera
from streamlod.core.frames import FrameSet
from streamlod.server.ingest import knocks
from streamlod.server.ingest.knocks import Knocks
from streamlod.server.ingest.watch import Watch
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.stages.opened import open_job
from streamlod.server.pipeline.stages.stream import train_stream
from tests.core.calibration.checks import room
from tests.core.data.writers import write_video
from tests.server.brief import brief_training
from tests.server.ingest.executors import AtOnce

RIG = room.cameras(4, (240, 134))
KNOCKED = 2
LIT, PASSED, TURNED, BACK, END = 2, 4, 7, 17, 27  # frames at which something begins
FEW = 8  # frames: two looks at every camera


def _turned(camera: Camera, degrees: float) -> Camera:
    turn = np.eye(4)
    turn[:3, :3] = rigid.rotations(np.array([[0.0, np.radians(degrees), 0.0]]))[0]
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def _film(rig: Sequence[Camera], begin: int, end: int) -> list[list[UInt8]]:
    """Pictures of each camera."""
    frames = room.frames(rig, end)[begin:]
    return [[frame.images[number] for frame in frames] for number in range(len(rig))]


def _definition(folder: Path) -> dict[str, Any]:
    """A rig of files: the light is switched on, somebody passes close to one camera, one is turned and put back."""
    still = _film(RIG, 0, END)
    turned = _film([_turned(camera, 2.0 * (number == KNOCKED)) for number, camera in enumerate(RIG)], TURNED, BACK)
    cameras = []
    for number, camera in enumerate(RIG):
        pictures = still[number][:TURNED] + turned[number] + still[number][BACK:]
        for frame in range(LIT, END):
            pictures[frame] = cv2.convertScaleAbs(pictures[frame], alpha=0.6, beta=40)
        if number == 0:
            for frame in range(PASSED, TURNED):
                pictures[frame][:, 30:210] = still[3][0][::-1, 10 * frame % 60 :][:, :180]
        write_video(folder / f"{number}.mp4", pictures, options={"crf": "16"})
        cameras.append(
            {
                "name": camera.name,
                "source": str(folder / f"{number}.mp4"),
                "width": camera.width,
                "height": camera.height,
                "intrinsics": camera.intrinsics.tolist(),
                "world_to_camera": camera.world_to_camera.tolist(),
            }
        )
    return {"fps": 30, "realtime": False, "depth_bounds": [0.5, 12], "cameras": cameras}


@pytest.mark.long
def test_a_camera_knocked_in_mid_stream_is_named_left_out_and_taken_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(knocks, "_SHARE", 1.0)  # at every frame; on time alone, see below
    monkeypatch.setattr(Watch, "begin", _begin_and_wait)  # a busy machine may let a look's thread wait
    seen: list[FrameSet] = []
    named: list[set[str]] = []
    job = TrainJob(live=_definition(tmp_path), preset="live", points="random")
    opened = replace(open_job(job), on_read=seen.append)
    with brief_training(12), closing(train_stream(opened)) as frames:
        for _ in frames:
            figures = opened.statistics()
            if figures is not None:
                named.append({name for name, one in figures.cameras.items() if one.knocked})
    name = RIG[KNOCKED].name
    told = [number for number, names in enumerate(named) if names]
    assert all(names in (set(), {name}) for names in named), "nobody else, in other light and with somebody near"
    assert told, "the turned camera is named"
    assert TURNED < told[0] < TURNED + FEW, told
    left_out = [frame.index for frame in seen if not frame.present[KNOCKED]]
    assert TURNED < min(left_out) < TURNED + FEW
    assert left_out == list(range(min(left_out), max(left_out) + 1))
    assert BACK <= max(left_out) < BACK + FEW
    assert all(frame.present[[0, 1, 3]].all() for frame in seen)


def _begin_and_wait(watch: Watch, look: Callable[[], None], pool: Executor) -> bool:
    del watch
    pool.submit(look).result()
    return True


class _Slow(list[UInt8]):
    """Pictures of which each takes ten milliseconds to look at."""

    now, looks = 0.0, 0

    def __getitem__(self, number: Any) -> Any:
        self.now += 0.01
        self.looks += 1
        return super().__getitem__(number)


def test_looking_takes_a_fiftieth_of_the_time() -> None:
    images = _Slow([np.zeros((36, 64, 3), np.uint8)] * 3)
    watch = Knocks(3, lambda: images.now)
    for _ in range(900):  # half a minute of frames
        watch.look(images, np.ones(3, np.bool_), AtOnce())
        images.now += 1 / 30
    saved = 10 / 0.5  # looks for which there was time before
    assert saved + 55 < images.looks < saved + 65


@pytest.mark.long
def test_a_knock_is_told_at_its_second_picture_although_there_is_little_time_to_look() -> None:
    """Four cameras, a look at one of which takes a tenth of a second, so that there is time for one in five seconds."""
    before, still = room.frames(RIG, 2)
    turned = room.frames([_turned(camera, 2.0 * (number == KNOCKED)) for number, camera in enumerate(RIG)], 2)[1]
    images = _Slow(before.images)
    watch, told = Knocks(4, lambda: 10 * images.now), []
    for frame in range(400):
        images[:] = turned.images if frame >= 390 else still.images
        watch.look(images, np.ones(4, np.bool_), AtOnce())
        images.now += 0.01  # ten frames a second
        told.append(watch.knocked.tolist())
    assert not any(map(any, told[:391]))
    assert told[391:] == [[number == KNOCKED for number in range(4)]] * 9


def test_a_look_that_breaks_is_logged_once_and_ends_the_watch(caplog: pytest.LogCaptureFixture) -> None:
    picture = _film(RIG[:1], 0, 1)[0][0]
    turned = np.asarray(cv2.warpAffine(picture, cv2.getRotationMatrix2D((120, 67), 3, 1), (240, 134)), np.uint8)
    watch, told = Knocks(2, lambda: 0.0), []
    with ThreadPoolExecutor(1) as pool:
        for image in [picture, turned, turned, picture[:0], picture, picture]:
            watch.look([image, picture], np.ones(2, np.bool_), pool)
            pool.submit(int).result()  # the look is over
            told.append(watch.knocked.tolist())
    assert told[2] == [True, False], "while it was watched"
    assert told[-1] == [False, False], "nobody is left out for ever"
    assert [record.getMessage()[:40] for record in caplog.records] == ["knocked cameras are no longer watched fo"]


def _watched(pictures: Sequence[Sequence[UInt8]]) -> Knocks:
    """After so many instants of pictures of each camera, each of which is looked at."""
    watch = Knocks(len(pictures[0]), lambda: 0.0)
    for images in pictures:
        watch.look(images, np.ones(len(images), np.bool_), AtOnce())
    return watch


@pytest.mark.long
def test_where_most_cameras_have_moved_none_is_named() -> None:
    """It is the scene that did, or all are on one truss that was lowered."""
    before = [film[0] for film in _film(RIG, 0, 1)]
    for moved, expected in ((1, 1), (2, 2), (3, 0), (4, 0)):
        rig = [_turned(camera, 2.0 * (number < moved)) for number, camera in enumerate(RIG)]
        after = [film[0] for film in _film(rig, 1, 2)]
        watch = _watched([before, after, after])
        assert watch.knocked.sum() == expected
        assert sum(pixels is not None and pixels > 3 for pixels in watch.shifts) == moved


def test_a_room_that_changes_bit_by_bit_does_not_hide_a_knock() -> None:
    """Landmarks that are gone are replaced by new ones while the camera stands."""
    first, other = _film([RIG[0], RIG[3]], 0, 1)
    stages = []
    for column in range(0, 241, 30):  # another room takes its place from the left
        picture = first[0].copy()
        picture[:, :column] = other[0][:, :column]
        stages += [[picture]] * 2
    turn = cv2.getRotationMatrix2D((120, 67), 3, 1)
    knocked = np.asarray(cv2.warpAffine(other[0], turn, (240, 134), borderMode=cv2.BORDER_REFLECT), np.uint8)
    assert _watched([[picture[0], first[0]] for picture in [*stages, [knocked], [knocked]]]).knocked.tolist() == [
        True,
        False,
    ]
