"""Pictures drawn by the server, for viewers that cannot draw: scene and camera in, JPEG out.

One thread draws for all viewers in turn; its kernels release the GIL, so the event loop keeps running.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import ModelError
from streamlod.core.render.cpu import render
from streamlod.core.render.pick import depth_along, pick
from streamlod.core.render.splatter import Splatter
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import anchor_positions
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.server.viewer.grades import Grade

T = TypeVar("T")

HEADER = struct.Struct("<IIIHHBBHI")  # number, epoch, version, width, height, quality, levels, 0, drawing time in us
_MAX_PAIRS = 1 << 24  # of a Gaussian and a tile: 64 MB and about a second, whatever a viewer asks for
_MIN_SIDE = 16  # pixels
_FULL_CHROMA = 90  # JPEG quality from which colour keeps its full resolution


@dataclass(frozen=True, slots=True, eq=False)
class RenderedPicture:
    """A JPEG file with its size in pixels, and how long it took to make."""

    jpeg: bytes
    width: int
    height: int
    seconds: float


class PictureRenderer:
    """The thread that draws pictures, for a limited number of viewers.

    Args:
        seats: most viewers that it draws for at the same time.
        most_pixels: of a picture.
    """

    def __init__(self, seats: int, most_pixels: int) -> None:
        self.limit(seats, most_pixels)
        self.taken = 0
        self._thread: ThreadPoolExecutor | None = None

    def limit(self, seats: int, most_pixels: int) -> None:
        """Have so many seats, and pictures of so many pixels, from now on; nobody who has a seat loses it."""
        self.seats, self._most_pixels = seats, most_pixels

    @property
    def is_full(self) -> bool:
        """Whether no seat is left."""
        return self.taken >= self.seats

    @contextlib.contextmanager
    def seat(self) -> Iterator[None]:
        """Take one seat while the context lasts; check `is_full` first."""
        assert not self.is_full
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1

    async def run(self, work: Callable[[], T]) -> T:
        """Run `work` in the drawing thread, after the work queued before it."""
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, thread_name_prefix="renderer")
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def render_picture(
        self, splatter: Splatter, scene: Scene, camera: Camera, levels: int, grade: Grade
    ) -> RenderedPicture:
        """Draw and compress; call it through `run`."""
        started = time.perf_counter()
        camera = fitted(camera, grade.scale, self._most_pixels)
        image = draw(splatter.cloud(scene, camera, levels), camera, scene)
        jpeg = compress(image, grade.quality)
        return RenderedPicture(jpeg, camera.width, camera.height, time.perf_counter() - started)

    def close(self) -> None:
        """End the thread after what it is doing."""
        if self._thread is not None:
            self._thread.shutdown(wait=False, cancel_futures=True)


def fitted(camera: Camera, scale: float, most_pixels: int) -> Camera:
    """`camera` with both sides of its picture scaled, and shrunk to at most `most_pixels`."""
    scale *= min(1.0, (most_pixels / (scale**2 * camera.width * camera.height)) ** 0.5)
    width, height = (max(_MIN_SIDE, int(side * scale)) for side in (camera.width, camera.height))
    return camera.scaled(width, height)


def draw(cloud: GaussianCloud, camera: Camera, scene: Scene) -> UInt8:
    """[H,W,3] uint8 RGB of the camera's size; coarser inside where the view would cost too much."""
    inner = camera
    while True:
        try:
            image = render(cloud, inner, scene.header.background, _MAX_PAIRS).image
            break
        except ModelError:
            size = max(1, inner.width // 2), max(1, inner.height // 2)
            if size == (1, 1):
                image = np.broadcast_to(scene.header.background, (1, 1, 3))
                break
            inner = inner.scaled(*size)
    picture = np.asarray(np.clip(np.round(image * 255), 0, 255), np.uint8)
    if inner is camera:
        return picture
    import cv2

    return np.asarray(cv2.resize(picture, (camera.width, camera.height)), np.uint8).reshape(
        camera.height, camera.width, 3
    )


def compress(image: UInt8, quality: int) -> bytes:
    """[H,W,3] RGB as a JPEG file."""
    import cv2

    chroma = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444 if quality >= _FULL_CHROMA else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, chroma]
    return bytes(cv2.imencode(".jpg", image[:, :, ::-1], options)[1])


def look_along(
    cloud: GaussianCloud, scene: Scene, origin: Float64, direction: Float64
) -> tuple[list[float] | None, float]:
    """The scene along a ray (`core.render.pick`): the point hit, if any, and the median depth of anchors around it."""
    point = pick(cloud, origin, direction)
    anchors = [anchor_positions(scene.header, number, level) for number, level in enumerate(scene.levels)]
    return None if point is None else point.tolist(), depth_along(np.concatenate(anchors), origin, direction)
