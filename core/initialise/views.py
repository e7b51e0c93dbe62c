"""The views that every method of finding first points works on: the cameras that delivered, at a small working size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet


@dataclass(frozen=True, slots=True, eq=False)
class WorkingViews:
    """V pinhole cameras of one size and their pictures.

    Attributes:
        cameras: V cameras, of the working size.
        images: [V,H,W,3] float32 RGB in [0, 1].
    """

    cameras: tuple[Camera, ...]
    images: Float32

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return int(self.images.shape[2]), int(self.images.shape[1])

    def resized(self, height: int) -> WorkingViews:
        """The same views with pictures of at most `height` rows, averaged over areas."""
        width, rows = self.size
        if rows <= height:
            return self
        columns = max(1, round(width * height / rows))
        images = np.stack([cv2.resize(image, (columns, height), interpolation=cv2.INTER_AREA) for image in self.images])
        return WorkingViews(tuple(camera.scaled(columns, height) for camera in self.cameras), images)


def working_views(frame: FrameSet, cameras: Sequence[Camera], height: int) -> WorkingViews:
    """The cameras that are present, with pictures of at most `height` rows.

    Raises:
        ValueError: as many pictures as cameras are needed, of the cameras' size.
        InputError: a camera still has lens distortion.
    """
    if len(cameras) != len(frame.images):
        raise ValueError(f"{len(frame.images)} pictures do not fit {len(cameras)} cameras")
    rows, columns = frame.images.shape[1:3]
    kept, pictures = [], []
    for camera, picture, present in zip(cameras, frame.images, frame.present, strict=True):
        if (camera.width, camera.height) != (columns, rows):
            raise ValueError(f"camera {camera.name} is not of its picture's size {columns}x{rows}")
        if not present:
            continue
        if camera.has_distortion:
            raise InputError(f"camera {camera.name}", "its pictures are distorted: undistort them before use")
        kept.append(camera)
        small = picture[None].astype(np.float32) / 255
        pictures.append(WorkingViews((camera,), small).resized(height))
    if not kept:
        raise InputError(f"frame {frame.index}", "no camera delivered a picture")
    return WorkingViews(tuple(v.cameras[0] for v in pictures), np.concatenate([v.images for v in pictures]))


def project(camera: Camera, points: Float64) -> tuple[Float64, Float64]:
    """[N,3] world points to ([N,2] pixels, [N] depth); pixels of points behind the camera mean nothing."""
    seen = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = seen[:, 2]
    safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
    pixels = seen[:, :2] / safe[:, None] @ camera.intrinsics[:2, :2].T + camera.intrinsics[:2, 2]
    return pixels, depth


def inside(camera: Camera, pixels: Float64, depth: Float64) -> Bool:
    """[N] which projected points lie in the picture and before the camera."""
    fits = (pixels >= 0).all(axis=1) & (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    return np.asarray(fits & (depth > 0), np.bool_)


def unproject(camera: Camera, pixels: Float64, depth: Float64) -> Float64:
    """[N,2] pixels at [N] depth along the optical axis to [N,3] world points."""
    homogeneous = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)
    seen = (homogeneous @ np.linalg.inv(camera.intrinsics).T) * depth[:, None]
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    return np.asarray((seen - translation) @ rotation, np.float64)


def pixel_centres(camera: Camera) -> Float64:
    """[H*W,2] the centre of every pixel, row by row."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([columns.ravel(), rows.ravel()], axis=1)
