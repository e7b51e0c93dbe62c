"""COLMAP's sparse models: cameras, images and points, binary or text.

Format: https://colmap.github.io/format.html. COLMAP's camera axes and pixel centres are those of `Camera`. Counts in
the files are believed only as far as the file is long enough for them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.arrays import Float64
from core.camera import Camera
from core.data.files import read_bytes, read_text
from core.errors import InputError
from core.frames import PointCloud

MAX_BYTES = 4 << 30
_NAMES = {0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV"}
_UNSUPPORTED = {5: "OPENCV_FISHEYE", 6: "FULL_OPENCV", 7: "FOV", 8: "SIMPLE_RADIAL_FISHEYE", 9: "RADIAL_FISHEYE"}
_PARAMETERS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8}
_QUATERNION_TOLERANCE = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class ColmapCamera:
    """A lens and sensor: model name, size in pixels and the model's parameters."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]

    def intrinsics(self) -> tuple[Float64, Float64]:
        """[3,3] intrinsics and [5] OpenCV distortion of the model."""
        values = self.parameters
        if self.model in ("PINHOLE", "OPENCV"):
            (fx, fy, cx, cy), rest = values[:4], values[4:]
        else:
            (fx, cx, cy), rest = values[:3], values[3:]
            fy = fx
        distortion = np.zeros(5)
        distortion[: len(rest)] = rest  # k1 | k1 k2 | k1 k2 p1 p2
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), distortion


@dataclass(frozen=True, slots=True, eq=False)
class ColmapImage:
    """A registered picture: file name, camera number and [4,4] world_to_camera."""

    name: str
    camera_id: int
    world_to_camera: Float64


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
    lenses = _cameras_bin(cameras) if cameras.suffix == ".bin" else _cameras_txt(cameras)
    pictures = _images_bin(images) if images.suffix == ".bin" else _images_txt(images)
    return ColmapModel(lenses, tuple(pictures))


def read_points(folder: Path) -> PointCloud:
    """The points of a sparse model; those whose coordinates float32 cannot hold are left out.

    Raises:
        InputError: missing or damaged file.
    """
    path = _file(folder, "points3D")
    rows = list(_points_bin(path) if path.suffix == ".bin" else _points_txt(path))
    table = np.array(rows, np.float64).reshape(-1, 6)
    table = table[(np.abs(table) < np.finfo(np.float32).max).all(axis=1)]
    return PointCloud(table[:, :3].astype(np.float32), np.clip(table[:, 3:] / 255, 0, 1).astype(np.float32))


def _file(folder: Path, stem: str) -> Path:
    for path in (folder / f"{stem}.bin", folder / f"{stem}.txt"):
        if path.is_file():
            return path
    raise InputError(folder, f"holds neither {stem}.bin nor {stem}.txt")


class _Cursor:
    """A place in a binary file that never runs over its end."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, MAX_BYTES), 0

    def take(self, form: struct.Struct) -> tuple[float, ...]:
        self.need(form.size)
        values = form.unpack_from(self.data, self.at)
        self.at += form.size
        return values

    def need(self, count: int) -> None:
        if self.at + count > len(self.data):
            raise InputError(self.path, f"ends at byte {len(self.data)}, in the middle of a record; copy it again")

    def skip(self, count: int) -> None:
        self.need(count)
        self.at += count

    def count(self, least_bytes: int) -> int:
        """A count of records that take at least `least_bytes` each."""
        (count,) = self.take(_COUNT)
        if count * least_bytes > len(self.data) - self.at:
            raise InputError(self.path, f"claims {count} records, more than its {len(self.data)} bytes can hold")
        return int(count)

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise InputError(self.path, "holds a name without an end; copy it again")
        text, self.at = self.data[self.at : end], end + 1
        return text.decode(errors="replace")


_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<iiQQ")
_IMAGE = struct.Struct("<i7di")
_POINT = struct.Struct("<Q3d3Bd")
_OBSERVATION_BYTES, _TRACK_BYTES = 24, 8


def _cameras_bin(path: Path) -> dict[int, ColmapCamera]:
    cursor, cameras = _Cursor(path), {}
    for _ in range(cursor.count(_CAMERA.size)):
        number, model_id, width, height = (int(value) for value in cursor.take(_CAMERA))
        model = _NAMES.get(model_id, _UNSUPPORTED.get(model_id, f"number {model_id}"))
        parameters = cursor.take(struct.Struct(f"<{_parameter_count(path, model)}d"))
        cameras[number] = ColmapCamera(model, width, height, parameters)
    return cameras


def _images_bin(path: Path) -> Iterator[ColmapImage]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(_IMAGE.size + 1 + _COUNT.size)):
        record = cursor.take(_IMAGE)
        name = cursor.name()
        cursor.skip(cursor.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
        yield _image(path, name, int(record[8]), record[1:5], record[5:8])


def _points_bin(path: Path) -> Iterator[tuple[float, ...]]:
    cursor = _Cursor(path)
    for _ in range(cursor.count(_POINT.size + _COUNT.size)):
        record = cursor.take(_POINT)
        cursor.skip(cursor.count(_TRACK_BYTES) * _TRACK_BYTES)
        yield record[1:7]


def _cameras_txt(path: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    for line, words in _lines(path):
        with _parsing(path, line):
            if not words:
                continue
            expected = _parameter_count(path, words[1])
            parameters = tuple(float(word) for word in words[4:])
            if len(parameters) != expected:
                raise InputError(path, f"line {line}: {words[1]} has {expected} parameters, not {len(parameters)}")
            cameras[int(words[0])] = ColmapCamera(words[1], int(words[2]), int(words[3]), parameters)
    return cameras


def _images_txt(path: Path) -> Iterator[ColmapImage]:
    """Two lines an image; the second, of observations, may be empty and is not needed."""
    expecting = True
    for line, words in _lines(path):
        if expecting and not words:
            continue
        if expecting:
            with _parsing(path, line):
                values = [float(word) for word in words[1:8]]
                number, name = int(words[8]), " ".join(words[9:])
                if not name:
                    raise InputError(path, f"line {line}: the picture's name is missing")
            yield _image(path, name, number, tuple(values[:4]), tuple(values[4:]))
        expecting = not expecting


def _points_txt(path: Path) -> Iterator[tuple[float, ...]]:
    for line, words in _lines(path):
        if words:
            with _parsing(path, line):
                values = tuple(float(word) for word in words[1:7])
                if len(values) < 6:
                    raise InputError(path, f"line {line}: a point needs x y z and red green blue")
            yield values


class _parsing:  # noqa: N801 - reads as a statement
    """Turns a number that cannot be read into an InputError with its line."""

    def __init__(self, path: Path, line: int) -> None:
        self.path, self.line = path, line

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, _: object) -> None:
        if isinstance(error, ValueError | IndexError | OverflowError):
            raise InputError(self.path, f"line {self.line}: words or numbers are missing or cannot be read") from error


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    for number, text in enumerate(read_text(path).splitlines(), 1):
        if not text.startswith("#"):
            yield number, text.split()


def _parameter_count(path: Path, model: str) -> int:
    if model not in _PARAMETERS:
        known = ", ".join(_PARAMETERS)
        raise InputError(path, f"camera model {model} is not supported ({known} are); undistort with COLMAP first")
    return _PARAMETERS[model]


def _image(
    path: Path, name: str, camera_id: int, quaternion: tuple[float, ...], translation: tuple[float, ...]
) -> ColmapImage:
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) < _QUATERNION_TOLERANCE:
        raise InputError(path, f"image {name}: its quaternion has length {length:.3g}, which is no rotation")
    w, x, y, z = np.asarray(quaternion) / length
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return ColmapImage(name, camera_id, pose)
