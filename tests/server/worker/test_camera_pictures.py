"""Small pictures of cameras: made now and then, shown to those who may watch, forgotten with the stream's end."""

from __future__ import annotations

import asyncio
import io
from pathlib import Path

import msgpack
import numpy as np
import pytest
from PIL import Image

from streamlod.core.frames import FrameSet
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.camera_pictures import CameraPictures, unpack_pictures
from streamlod.server.worker.messages import Tag
from tests.attack.test_rights import bearer, write_tokens
from tests.core.data.writers import rig
from tests.server.conftest import Clip, running
from tests.waiting import wait


def frame(brightness: int, *present: bool) -> FrameSet:
    images = np.full((2, 480, 960, 3), (brightness, 0, 0), np.uint8)
    return FrameSet(0, 0, images, np.array(present, np.bool_))


def test_the_newest_frame_is_made_small_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    pictures = CameraPictures(rig(["left", "right"], (960, 480)))
    assert pictures.take() is None
    pictures.note(frame(10, True, True))
    pictures.note(frame(200, True, False))
    body = pictures.take()
    assert body is not None
    found = unpack_pictures(body)
    assert list(found) == ["left"], "a camera that is missing has no picture"
    seen = np.asarray(Image.open(io.BytesIO(found["left"])))
    assert seen.shape == (160, 320, 3)
    assert np.abs(seen.reshape(-1, 3).mean(axis=0) - (200, 0, 0)).max() < 5
    pictures.note(frame(10, True, True))
    assert pictures.take() is None, "not yet"
    now += 1.1
    assert pictures.take() is not None
    assert pictures.take() is None, "nothing new"


def test_a_camera_whose_pictures_are_turned_for_training_is_shown_upright() -> None:
    pictures = CameraPictures(rig(["tall"], (120, 160)))
    upright = np.zeros((160, 120, 3), np.uint8)
    upright[:40] = 255
    pictures.note(FrameSet(0, 0, np.rot90(upright)[None], np.ones(1, np.bool_)))
    body = pictures.take()
    assert body is not None
    seen = np.asarray(Image.open(io.BytesIO(unpack_pictures(body)["tall"])))
    assert seen.shape == upright.shape
    assert np.abs(seen.astype(int) - upright).mean() < 2, "the light part is above"


@pytest.mark.parametrize("found", [[], {"left": "text"}])
def test_other_messages_are_refused(found: object) -> None:
    with pytest.raises(ValueError, match="map of"):
        unpack_pictures(msgpack.packb(found))


def test_who_may_watch_sees_them_while_the_stream_runs(clip: Clip, tmp_path: Path) -> None:
    settings = write_tokens(
        tmp_path, mine={"rights": ["read"], "streams": "main"}, other={"rights": ["read"], "streams": "stage"}
    )
    stills = msgpack.packb({"cam 1": b"jpeg"})
    address = "/v1/streams/main/cameras/cam%201.jpg"
    with running(settings, StreamSpec(play=clip.path, loop=True)) as server, server.client() as client:
        stream = server.registry.streams["main"]
        assert isinstance(stream, WorkerStream)
        wait(lambda: stream.state == "live")
        assert client.get(address, headers=bearer("mine")).status_code == 404
        asyncio.run(stream.work.on_message(Tag.PICTURES, stills))
        answer = client.get(address, headers=bearer("mine"))
        assert (answer.status_code, answer.content) == (200, b"jpeg")
        assert answer.headers["content-type"] == "image/jpeg"
        assert client.get(address, headers=bearer("other")).status_code == 403
        assert client.get(address).status_code == 401
        described = client.get("/v1/streams/main", headers=bearer("mine")).json()
        assert described["camera_pictures"] == ["cam 1"]
        stream.enter("ended")
        assert client.get(address, headers=bearer("mine")).status_code == 404


def test_they_are_off_by_default() -> None:
    assert not Settings().camera_pictures
