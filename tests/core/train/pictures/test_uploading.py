"""Pictures for training: the right ones, once, whoever sent them and when."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from streamlod.core.frames import FrameSet
from streamlod.core.train.pictures.uploading import _MAX_FRAMES, Uploader


@pytest.fixture(params=["cpu", pytest.param("gpu", marks=pytest.mark.cuda)])
def device(request: pytest.FixtureRequest) -> str:
    """The CPU, then a GPU or the pretend device."""
    return "cpu" if request.param == "cpu" else str(request.getfixturevalue("gpu"))


def test_pictures_are_the_same_sent_ahead_or_not(device: str) -> None:
    uploader, frames = Uploader(device), filmed(3)
    for frame in frames[:2]:
        uploader.begin(frame)
    for frame in (frames[1], frames[2], frames[0]):
        pictures = uploader.take(replace(frame, index=90))  # numbered anew on its way
        assert pictures.device.type == device
        np.testing.assert_allclose(pictures.cpu().numpy(), frame.images.astype(np.float32) / 255, atol=1e-7)


def test_what_was_sent_ahead_is_taken_once(device: str) -> None:
    uploader, (frame,) = Uploader(device), filmed(1)
    uploader.begin(frame)
    first = uploader.take(frame)
    first.zero_()
    assert float(uploader.take(frame).sum()) > 0


def test_only_a_few_wait(device: str) -> None:
    uploader, frames = Uploader(device), filmed(_MAX_FRAMES + 3)
    for frame in frames:
        uploader.begin(frame)
    assert len(uploader._waiting) == _MAX_FRAMES
    for frame in frames:  # those that gave way are sent again
        torch.testing.assert_close(uploader.take(frame).cpu(), Uploader("cpu").take(frame), rtol=0, atol=1e-7)


def test_a_reading_thread_sends_while_this_one_trains(device: str) -> None:
    uploader, frames, wrong = Uploader(device), filmed(30), list[int]()
    turn = threading.Semaphore(2)

    def read() -> None:
        for frame in frames:
            turn.acquire()
            uploader.begin(frame)

    thread = threading.Thread(target=read)
    thread.start()
    for frame in frames:
        pictures = uploader.take(frame)
        if not np.allclose(pictures.cpu().numpy(), frame.images.astype(np.float32) / 255, atol=1e-7):
            wrong.append(frame.index)
        turn.release()
    thread.join()
    assert not wrong


def filmed(count: int) -> list[FrameSet]:
    generator = np.random.default_rng(0)
    sizes = (2, 9, 7, 3)
    pictures = [generator.integers(1, 256, sizes, dtype=np.uint8) for _ in range(count)]
    return [FrameSet(i, i, picture, np.ones(2, np.bool_)) for i, picture in enumerate(pictures)]
