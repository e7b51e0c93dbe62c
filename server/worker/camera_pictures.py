"""Small pictures of what a stream's cameras see, for viewers that compare the model with it."""

from __future__ import annotations

import time
from collections.abc import Sequence

import msgpack
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.frames import FrameSet
from streamlod.server.ingest.small_jpeg import small_jpeg

_SECONDS = 1.0  # from one round of pictures to the next


class CameraPictures:
    """Keeps the newest frame and compresses it now and then.

    Args:
        cameras: as they stood (`Dataset.upright`), in the order of the frames' images.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = tuple(cameras)
        self._newest: FrameSet | None = None
        self._next = 0.0

    def note(self, frame: FrameSet) -> None:
        """A frame was read."""
        self._newest = frame

    def take(self) -> bytes | None:
        """The newest frame for `unpack_pictures`, where there is a new one and it is time; from one thread."""
        frame, now = self._newest, time.monotonic()
        if frame is None or now < self._next:
            return None
        self._newest, self._next = None, now + _SECONDS
        seen = zip(self._cameras, frame.images, frame.present, strict=True)
        pictures = {camera.name: small_jpeg(_upright(image, camera)) for camera, image, present in seen if present}
        return bytes(msgpack.packb(pictures))


def unpack_pictures(body: bytes) -> dict[str, bytes]:
    """JPEG files by camera, of `CameraPictures.take`.

    Raises:
        ValueError: the body is something else.
    """
    found = msgpack.unpackb(body)
    if not isinstance(found, dict) or not all(isinstance(x, str) and isinstance(y, bytes) for x, y in found.items()):
        raise ValueError("camera pictures must be a map of names to JPEG files")
    return found


def _upright(image: UInt8, camera: Camera) -> UInt8:
    """An image [H,W,3] turned back to how `camera` stood, where it was turned to lie like others."""
    return image if image.shape[:2] == (camera.height, camera.width) else np.rot90(image, -1)
