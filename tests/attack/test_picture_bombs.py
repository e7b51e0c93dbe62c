"""Pictures that unpack to more than they announce, and pictures that are not whole."""

from __future__ import annotations

import random
import struct
import zlib

import cv2
import numpy as np
import pytest

from streamlod.core.data.announced import announced_picture
from streamlod.core.data.pictures import decode

_SIZE = (240, 136)


def encoded(suffix: str, size: tuple[int, int] = _SIZE, *options: int) -> bytes:
    pixels = np.random.default_rng(1).integers(0, 255, (size[1], size[0], 3), np.uint8)
    return cv2.imencode(suffix, pixels, options)[1].tobytes()


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def with_size(jpeg: bytes, width: int, height: int) -> bytes:
    at = jpeg.index(b"\xff\xc0")
    return jpeg[: at + 5] + struct.pack(">HH", height, width) + jpeg[at + 9 :]


def frame_header(width: int, height: int) -> bytes:
    return b"\xff\xc0" + struct.pack(">HBHHB", 17, 8, height, width, 3) + b"\x01\x11\x00\x02\x11\x00\x03\x11\x00"


def hidden_behind(marker: bytes) -> bytes:
    """A large JPEG with a small frame header where a reader arrives that takes what follows `marker` for a length."""
    large = with_size(encoded(".jpg"), 20_000, 20_000)
    comment = frame_header(*_SIZE).rjust(0xFFF0, b"\0") + b"\0" * 12
    return large[:2] + marker + b"\xff\xfe" + struct.pack(">H", len(comment) + 2) + comment + large[2:]


@pytest.mark.parametrize(
    "bomb",
    [
        *(hidden_behind(marker) for marker in (b"\xff\x01", b"\xff\xd0", b"\xff\xd8", b"\xff\xd9", b"\xff\x02")),
        encoded(".jpg")[:2] + b"\0\0" + with_size(encoded(".jpg"), 20_000, 20_000)[2:],
        encoded(".jpg")[:2] + frame_header(*_SIZE) + with_size(encoded(".jpg"), 20_000, 20_000)[2:],
        encoded(".png").replace(b"IDAT", chunk(b"IHDR", struct.pack(">IIBBBBB", 20_000, 20_000, 8, 2, 0, 0, 0)), 1),
        encoded(".png")[:8] + chunk(b"gAMA", bytes(4)) + encoded(".png")[8:],
        b"\xff\xd8" + b"\xff\xfe\x00\x02" * 100_000,
        encoded(".png")[:33] + chunk(b"PLTE", b"") * 99_999 + encoded(".png")[33:],
        with_size(encoded(".jpg"), 0, 136),
    ],
)  # fmt: skip
def test_an_ambiguous_header_is_refused(bomb: bytes) -> None:
    found = announced_picture(bomb)
    assert found is None or found.size != _SIZE


def test_text_and_animation_that_unpack_without_end_are_not_decoded() -> None:
    png = encoded(".png")
    text = b"Comment\0\0" + zlib.compress(bytes(50_000_000))
    bomb = png[:33] + chunk(b"zTXt", text) + chunk(b"acTL", struct.pack(">II", 60_000, 0)) + png[33:]
    found = announced_picture(bomb)
    assert found is not None
    assert found.data == png
    assert np.array_equal(decode(found), cv2.imdecode(np.frombuffer(png, np.uint8), 1)[:, :, ::-1])


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_whatever_is_accepted_decodes_to_what_it_announced(suffix: str) -> None:
    chooser, small = random.Random(suffix), (40, 24)
    whole, accepted = encoded(suffix, small, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), 0
    for _ in range(2000):
        data = bytearray(whole)
        for _ in range(chooser.randint(1, 3)):
            at = chooser.randrange(min(len(data), 800))
            if chooser.random() < 0.5:
                data[at] = chooser.choice([0, 1, 0xFF, 0xC0, 0xC2, 0xD8, 0xDA, chooser.randrange(256)])
            else:
                data[at:at] = chooser.choice([b"\xff\x01", b"\xff", b"\xff\xfe\x00\x03\x00", frame_header(48, 32)])
        found = announced_picture(bytes(data))
        if found is None or found.size != small:
            continue
        accepted += 1
        try:
            pixels = cv2.imdecode(np.frombuffer(found.data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            continue
        assert pixels is None or pixels.shape == (24, 40, 3)
    assert accepted > 100


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_part_of_a_picture_is_none(suffix: str) -> None:
    whole = encoded(suffix)
    for size in range(0, len(whole) - 12, 97):
        assert announced_picture(whole[:size]) is None
