"""COLMAP's sparse models: cameras, images and points, binary or text.

Format: https://colmap.github.io/format.html. COLMAP's camera axes and pixel centres are those of `Camera`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.data.colmap import binary, text
from streamlod.core.data.colmap.types import ColmapCamera, ColmapImage
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud


@dataclass(frozen=True, slots=True, eq=False)
class ColmapModel:
    """Cameras by number, and images in the file's order."""

    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]

    def camera_of(self, image: ColmapImage, name: str) -> Camera:
        """The camera called `name` that took `image`; InputError as for `Camera`."""
        if image.camera_id not in self.cameras:
            raise InputError(f"image {image.name}", f"was taken by camera {image.camera_id}, which does not exist")
        lens = self.cameras[image.camera_id]
        intrinsics, distortion = lens.intrinsics()
        return Camera(name, intrinsics, image.world_to_camera, lens.width, lens.height, distortion)


def find_model(folder: Path) -> Path | None:
    """The folder of the sparse model that belongs to a data set's `folder`: sparse/0, sparse or itself."""
    for candidate in (folder / "sparse" / "0", folder / "sparse", folder):
        if any((candidate / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
            return candidate
    return None


def read_model(folder: Path) -> ColmapModel:
    """Cameras and images of a sparse model; binary files go before text files.

    Raises:
        InputError: missing or damaged files, or a camera model that is not supported.
    """
    cameras, images = _file(folder, "cameras"), _file(folder, "images")
    lenses = (binary if cameras.suffix == ".bin" else text).read_cameras(cameras)
    pictures = (binary if images.suffix == ".bin" else text).read_images(images)
    return ColmapModel(lenses, tuple(pictures))


def read_points(folder: Path) -> PointCloud:
    """The points of a sparse model; those whose coordinates float32 cannot hold are left out.

    Raises:
        InputError: missing or damaged file.
    """
    path = _file(folder, "points3D")
    rows = (binary if path.suffix == ".bin" else text).read_points(path)
    table = np.array(list(rows), np.float64).reshape(-1, 6)
    table = table[(np.abs(table) < np.finfo(np.float32).max).all(axis=1)]
    return PointCloud(table[:, :3].astype(np.float32), np.clip(table[:, 3:] / 255, 0, 1).astype(np.float32))


def _file(folder: Path, stem: str) -> Path:
    for path in (folder / f"{stem}.bin", folder / f"{stem}.txt"):
        if path.is_file():
            return path
    raise InputError(folder, f"holds neither {stem}.bin nor {stem}.txt")
