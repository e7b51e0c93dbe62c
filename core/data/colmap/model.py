"""COLMAP's sparse models: cameras, images and points, binary or text.

Format: https://colmap.github.io/format.html. COLMAP's camera axes and pixel centres are those of `Camera`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.data.colmap import binary, text
from streamlod.core.data.colmap.types import ColmapCamera, ColmapImage
from streamlod.core.data.names import folders_in, listed
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud

_log = logging.getLogger(__name__)


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


def has_model(folder: Path) -> bool:
    """Whether `find_model` finds one."""
    return bool(_models(folder))


def find_model(folder: Path) -> Path | None:
    """The sparse model that belongs to a data set's `folder`: one in sparse or colmap/sparse, these, or `folder`.

    COLMAP writes one for each part of the pictures that it could not connect with the others: the largest counts.
    """
    models = _models(folder)
    if len(models) < 2:
        return models[0] if models else None
    counts = [_image_count(model) for model in models]
    best = models[counts.index(max(counts))]
    _log.warning(
        "%s: holds %d models, and %s is used, which has most pictures (%s)",
        *(best.parent, len(models), best.name, listed(f"{m.name}: {n}" for m, n in zip(models, counts, strict=True))),
    )
    return best


def _models(folder: Path) -> list[Path]:
    homes = [folder / "sparse", folder / "colmap" / "sparse"]  # COLMAP's, and nerfstudio's
    inner = [folders_in(home) for home in homes if home.is_dir()]
    for candidates in (*inner, homes, [folder]):
        found = [c for c in candidates if any((c / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))]
        if found:
            return found
    return []


def _image_count(folder: Path) -> int:
    """Pictures of a model, 0 for one that cannot be read."""
    try:
        return len(read_model(folder).images)
    except InputError:
        return 0


def read_model(folder: Path) -> ColmapModel:
    """Cameras and images of a sparse model; binary files go before text files.

    Raises:
        InputError: missing or damaged files, or a camera model that is not supported.
    """
    cameras, images = _file(folder, "cameras"), _file(folder, "images")
    lenses = (binary if cameras.suffix == ".bin" else text).read_cameras(cameras)
    pictures = (binary if images.suffix == ".bin" else text).read_images(images)
    return ColmapModel(lenses, tuple(pictures))


def points_of(folder: Path) -> Callable[[Similarity], PointCloud] | None:
    """`read_points` of a sparse model, None for one without points."""
    if not any((folder / f"points3D.{kind}").is_file() for kind in ("bin", "txt")):
        return None
    return lambda space: read_points(folder, space)


def read_points(folder: Path, space: Similarity = UNCHANGED) -> PointCloud:
    """The points of a sparse model in `space`; those whose coordinates float32 cannot hold are left out.

    Raises:
        InputError: missing or damaged file.
    """
    path = _file(folder, "points3D")
    rows = (binary if path.suffix == ".bin" else text).read_points(path)
    table = np.array(list(rows), np.float64).reshape(-1, 6)
    table[:, :3] = space.positions(table[:, :3])
    table = table[(np.abs(table) < np.finfo(np.float32).max).all(axis=1)]
    return PointCloud(table[:, :3].astype(np.float32), np.clip(table[:, 3:] / 255, 0, 1).astype(np.float32))


def _file(folder: Path, stem: str) -> Path:
    for path in (folder / f"{stem}.bin", folder / f"{stem}.txt"):
        if path.is_file():
            return path
    raise InputError(folder, f"holds neither {stem}.bin nor {stem}.txt")
