"""COLMAP's binary files. Counts in them are believed only as far as the file is long enough for them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from streamlod.core.data.colmap.types import MODEL_NAMES, ColmapCamera, ColmapImage, colmap_image, parameter_count
from streamlod.core.data.files import read_bytes
from streamlod.core.errors import InputError

MAX_BYTES = 4 << 30
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<iiQQ")
_IMAGE = struct.Struct("<i7di")
_POINT = struct.Struct("<Q3d3Bd")
_OBSERVATION_BYTES, _TRACK_BYTES = 24, 8


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Cameras by number; InputError for damage or models that are not supported."""
    cursor, cameras = _Cursor(path), {}
    for _ in range(cursor.count(_CAMERA.size)):
        number, model_id, width, height = (int(value) for value in cursor.take(_CAMERA))
        model = MODEL_NAMES.get(model_id, f"number {model_id}")
        parameters = cursor.take(struct.Struct(f"<{parameter_count(path, model)}d"))
        cameras[number] = ColmapCamera(model, width, height, parameters)
    return cameras


def read_images(path: Path) -> Iterator[ColmapImage]:
    """Images in order, their observations passed over; InputError for damage."""
    cursor = _Cursor(path)
    for _ in range(cursor.count(_IMAGE.size + 1 + _COUNT.size)):
        record = cursor.take(_IMAGE)
        name = cursor.name()
        cursor.skip(cursor.count(_OBSERVATION_BYTES) * _OBSERVATION_BYTES)
        yield colmap_image(path, name, int(record[8]), record[1:5], record[5:8])


def read_points(path: Path) -> Iterator[tuple[float, ...]]:
    """x y z red green blue of each point; InputError for damage."""
    cursor = _Cursor(path)
    for _ in range(cursor.count(_POINT.size + _COUNT.size)):
        record = cursor.take(_POINT)
        cursor.skip(cursor.count(_TRACK_BYTES) * _TRACK_BYTES)
        yield record[1:7]


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
        return text.decode(errors="surrogateescape")  # as Python's file names: bytes of other encodings are kept
