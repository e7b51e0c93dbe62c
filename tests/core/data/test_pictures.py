"""Still pictures from files."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.data.pictures import picture_size, read_picture
from streamlod.core.errors import InputError
from tests.core.data.writers import picture, write_picture


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_size_and_pixels(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_picture(path, picture(3, 5, (80, 48)))
    assert picture_size(path) == (80, 48)
    difference = read_picture(path).astype(int) - picture(3, 5, (80, 48))
    assert np.abs(difference).max() <= (0 if suffix == ".png" else 8)


def test_grey_becomes_rgb(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), np.full((4, 6), 77, np.uint8))
    assert read_picture(tmp_path / "a.png").tolist() == [[[77, 77, 77]] * 6] * 4


def test_faults_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with pytest.raises(InputError, match=r"a\.png: cannot be read: No such file"):
        read_picture(path)
    path.write_bytes(b"GIF89a")
    with pytest.raises(InputError, match=r"a\.png: is neither a PNG nor a JPEG"):
        read_picture(path)
    write_picture(path, picture(0, 0))
    data = path.read_bytes()
    path.write_bytes(data[:16] + struct.pack(">II", 100_000, 100_000) + data[24:])
    with pytest.raises(InputError, match="a picture of 100000x100000 is refused"):
        picture_size(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_any_cut_is_refused_or_read_whole_sized(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_picture(path, picture(0, 0))
    data = path.read_bytes()
    for size in range(0, len(data), 23):
        path.write_bytes(data[:size])
        assert _shape_or_none(path) in ((64, 96, 3), None)  # decoders fill in what is missing at the end


def _shape_or_none(path: Path) -> tuple[int, ...] | None:
    try:
        return read_picture(path).shape
    except InputError:
        return None
