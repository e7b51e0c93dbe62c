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


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_transparency_lies_over_black(tmp_path: Path, depth: type[np.unsignedinteger]) -> None:
    most = np.iinfo(depth).max
    pixels = np.full((4, 6, 4), most, depth)
    pixels[:, :2, 3] = 0  # what lies under it is white, and nobody is to see it
    pixels[:, 2:4, 3] = most // 5
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    assert read_picture(tmp_path / "a.png")[0, :, 0].tolist() == [0, 0, 51, 51, 255, 255]


def test_a_transparent_colour_of_a_palette_is_black(tmp_path: Path) -> None:
    images = pytest.importorskip("PIL.Image")
    drawn = images.new("P", (6, 4), 1)
    drawn.putpalette([200, 10, 10, 10, 200, 10])
    drawn.putpixel((0, 0), 0)
    drawn.save(tmp_path / "a.png", transparency=0)
    assert read_picture(tmp_path / "a.png")[0, :2].tolist() == [[0, 0, 0], [10, 200, 10]]


@pytest.mark.parametrize("progressive", [0, 1])
def test_data_behind_a_jpeg_is_left_out(tmp_path: Path, progressive: int) -> None:
    """Phones append a film; by chance it holds many bytes that look like the beginning of a scan."""
    noise = np.random.default_rng(0).integers(0, 256, (40, 60, 3)).astype(np.uint8)
    _, data = cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])
    path = tmp_path / "a.jpg"
    path.write_bytes(data.tobytes())
    alone = read_picture(path)
    path.write_bytes(data.tobytes() + 5000 * b"\xff\xda\x00\x08")
    np.testing.assert_array_equal(read_picture(path), alone)


@pytest.mark.parametrize(("order", "mark"), [("<", b"II"), (">", b"MM")])
def test_an_orientation_that_is_not_followed_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, order: str, mark: bytes
) -> None:
    """Exif of a phone held upside down: COLMAP and nerfstudio calibrate pixels as they are stored."""
    write_picture(tmp_path / "a.jpg", picture(3, 5))
    data = (tmp_path / "a.jpg").read_bytes()
    for orientation in (3, 1):
        exif = b"Exif\0\0" + mark + struct.pack(order + "HIH", 42, 8, 2)
        exif += struct.pack(order + "HHI4sHHIHHI", 0x10F, 2, 4, b"abc", 0x112, 3, 1, orientation, 0, 0)
        (tmp_path / "a.jpg").write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:])
        assert picture_size(tmp_path / "a.jpg") == (96, 64)
    assert len([message for message in caplog.messages if "its Exif says that it is to be turned" in message]) == 1
    cut = (tmp_path / "a.jpg").read_bytes()
    for value in range(256):  # wherever the directory begins and ends
        (tmp_path / "a.jpg").write_bytes(cut[:16] + bytes([value]) * 6 + cut[22:])
        picture_size(tmp_path / "a.jpg")
