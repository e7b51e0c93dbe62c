"""Pictures on their way to the device that trains, so that those of the next frame travel while this one trains."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from streamlod.core.arrays import UInt8
from streamlod.core.frames import FrameSet

_MAX_FRAMES = 4  # frames on their way or waiting; a reader that is further ahead than that sends in vain


@dataclass(frozen=True, slots=True, eq=False)
class _Sent:
    """The host's images [C,H,W,3], the device's pictures of them, and the event after which those are there."""

    images: UInt8
    pictures: Tensor
    arrival: Any


class Uploader:
    """Sends pictures to `device`, from any thread; on a GPU from pinned memory on a stream of its own."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._module: Any = torch.get_device_module(device)
        self._stream: Any = None if device == "cpu" else self._module.Stream(device)
        self._waiting, self._lock = deque[_Sent](maxlen=_MAX_FRAMES), threading.Lock()

    def begin(self, frames: FrameSet) -> None:
        """Send the pictures of `frames` now; does not wait for their arrival. The oldest not yet taken give way."""
        sent = self._send(frames.images)
        with self._lock:
            self._waiting.append(sent)

    def take(self, frames: FrameSet) -> Tensor:
        """[C,H,W,3] float32 pictures of `frames` in [0, 1], for work on the current stream; sent now if not before."""
        with self._lock:
            found = next((sent for sent in self._waiting if sent.images is frames.images), None)
            if found is not None:
                self._waiting.remove(found)
        sent = found or self._send(frames.images)
        if sent.arrival is not None:
            here = self._module.current_stream()
            here.wait_event(sent.arrival)
            sent.pictures.record_stream(here)  # so that its memory is not given away while this stream reads it
        return sent.pictures

    def _send(self, images: UInt8) -> _Sent:
        host = torch.from_numpy(images)
        if self._stream is None:
            return _Sent(images, host.to(self._device).float().div_(255), None)
        with self._module.stream(self._stream):
            pictures = host.pin_memory().to(self._device, non_blocking=True).float().div_(255)
            return _Sent(images, pictures, self._stream.record_event())
