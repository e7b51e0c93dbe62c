"""A rig in a textured room, drawn by meeting each ray with the room's walls."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.frames import FrameSet

_HALF = np.array([3.0, 3.0, 2.0])  # metres from the middle to the walls
_TEXELS = 110  # a metre


def cameras(count: int = 6, size: tuple[int, int] = (480, 270)) -> tuple[Camera, ...]:
    """Cameras side by side that look at one corner of the room."""
    found = []
    for number in range(count):
        eye = np.array([-1.6 + 0.1 * number, 1.6 - 0.62 * number, 0.2 * (number % 2)])
        pose = look_at(eye, np.array([2.4, 0.3, 0.0]), np.array([0, 0, 1.0]))
        found.append(pinhole(f"cam_{number}", (380.0, 380.0), (size[0] / 2, size[1] / 2), size, pose))
    return tuple(found)


def frames(rig: Sequence[Camera], count: int = 2) -> list[FrameSet]:
    """Instants, in which nothing but the noise changes."""
    textures = [_texture(face) for face in range(6)]
    still = [_drawn(camera, textures) for camera in rig]
    found = []
    for index in range(count):
        random = np.random.default_rng(index)
        noisy = [picture + random.normal(0, 1.5, picture.shape) for picture in still]
        images = np.clip(np.array(noisy), 0, 255).astype(np.uint8)
        found.append(FrameSet(index, index * 33_000_000, images, np.ones(len(rig), np.bool_)))
    return found


@cache
def _texture(face: int) -> UInt8:
    """[S,S] blobs and edges of many sizes, unlike those of other faces."""
    random = np.random.default_rng(100 + face)
    side = int(_TEXELS * 6)
    picture = np.full((side, side), 110, np.uint8)
    for _ in range(900):
        corner = random.integers(0, side, 2)
        extent = random.integers(4, 50, 2)
        shade = int(random.integers(20, 235))
        cv2.rectangle(picture, corner.tolist(), (corner + extent).tolist(), shade, -1)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.8), np.uint8)


def _drawn(camera: Camera, textures: Sequence[UInt8]) -> np.ndarray:
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.intrinsics).T
    rays = local @ camera.world_to_camera[:3, :3]
    eye = camera.centre
    with np.errstate(divide="ignore"):
        reach = (np.sign(rays) * _HALF - eye) / rays  # to the wall that each axis leads to
    axis = reach.argmin(axis=-1)
    points = eye + rays * reach.min(axis=-1, keepdims=True)
    picture = np.zeros((camera.height, camera.width, 3))
    for face in range(6):
        which = face // 2
        here = (axis == which) & ((rays[..., which] > 0) == bool(face % 2))
        u, v = (np.delete(points, which, axis=-1)[..., n] + 3.0 for n in (0, 1))
        seen = cv2.remap(textures[face], (u * _TEXELS).astype(np.float32), (v * _TEXELS).astype(np.float32),
                         cv2.INTER_LINEAR)  # fmt: skip
        picture[here] = seen[here][:, None]
    return picture
