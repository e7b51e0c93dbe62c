"""Bounds of what a picture costs to decode, whatever its bytes say: memory of a process that decodes them all."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.data.announced import MAX_SCANS, announced_picture
from streamlod.core.data.pictures import decode
from tests.attack.test_picture_bombs import chunk, encoded

SIZE = (480, 270)
_SCAN = b"\xff\xda" + struct.pack(">HBBBBBB", 8, 1, 1, 0, 1, 63, 0x10) + b"\0"  # refines every block, in 11 bytes


def with_scans(count: int) -> bytes:
    whole = encoded(".jpg", SIZE, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    return whole[:-2] + _SCAN * count + whole[-2:]


def with_pixels(count: int, size: tuple[int, int] = SIZE) -> bytes:
    """A PNG whose compressed pixels unpack to `count` bytes, far more than its header announces."""
    header = struct.pack(">IIBBBBB", *size, 8, 2, 0, 0, 0)
    packer, million = zlib.compressobj(1), bytes(1_000_000)
    body = b"".join(packer.compress(million) for _ in range(count // len(million))) + packer.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def test_a_jpeg_of_many_scans_is_refused() -> None:
    usual = announced_picture(with_scans(0))
    assert usual is not None
    assert decode(usual) is not None
    most = announced_picture(with_scans(MAX_SCANS - 10))
    assert most is not None
    assert announced_picture(with_scans(MAX_SCANS)) is None


_DECODE = """
from pathlib import Path
from streamlod.core.data.announced import announced_picture
from streamlod.core.data.pictures import decode
from tests.attack import test_picture_costs as costs
pictures = costs.hostile()
decode(announced_picture(costs.with_scans(0)))
decode(announced_picture(costs.encoded(".png", costs.SIZE)))
before = costs.peak_bytes()
found = [picture for data in pictures if (picture := announced_picture(data)) and picture.size == costs.SIZE]
for picture in found:  # those that a camera of that calibration is let through with
    decode(picture)
print(len(found), costs.peak_bytes() - before)
"""
_ROOM = 24 * SIZE[0] * SIZE[1] + (8 << 20)  # coefficients, rows and copies, and what an allocator takes at once


def peak_bytes() -> int:
    """Most memory that this process has asked for so far."""
    found = re.search(r"^VmPeak:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return 1024 * int(found[1])


def hostile() -> list[bytes]:
    """Damaged pictures, and some that unpack to more."""
    chooser = np.random.default_rng(4)
    found = [with_pixels(60_000_000), with_scans(MAX_SCANS - 10)]
    for whole in (encoded(".png", SIZE), encoded(".jpg", SIZE), with_scans(0)):
        for _ in range(20):
            data = bytearray(whole)
            for at in chooser.integers(0, 700, 3):
                data[at] = chooser.integers(0, 256)
            found.append(bytes(data))
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_is_bounded_by_the_announced_size_whatever_the_bytes_say() -> None:
    one_heap = {**os.environ, "MALLOC_ARENA_MAX": "1"}  # else a thread that has to wait for memory reserves 64 MiB more
    done = subprocess.run([sys.executable, "-c", _DECODE], env=one_heap, capture_output=True, text=True, check=True)
    decoded, more = map(int, done.stdout.split())
    assert decoded > 10
    assert more < _ROOM
