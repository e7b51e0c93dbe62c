"""Calibration files with bytes changed, removed and added: accepted, or refused as documented, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from tests.core.data.writers import (
    picture,
    rig,
    write_caliscope,
    write_colmap_binary,
    write_colmap_text,
    write_picture,
    write_transforms,
    write_video_clip,
)

NAMES = ("cam00", "cam01")
POINTS = np.array([[0.5, -1, 2, 255, 128, 0], [1, 2, 3, 10, 20, 30]])
# what a byte is replaced by: text that means something to one of the parsers, and bytes that do not
PIECES = (b"", b"\0", b"-", b"9999999999", b"nan", b"1e999", b'"', b"[", b"{}", b"null", b"\n", b",", b"\xff\xfe", b"#")


def _pictures(folder: Path) -> None:
    for index, name in enumerate(NAMES):
        write_picture(folder / "images" / f"{name}.png", picture(index, 0))


def _n3dv(folder: Path) -> None:
    write_video_clip(folder, NAMES, frames=1)
    (folder / "distortion.json").write_text('{"cam00": {"k1": 0.01}, "cam01": {"p1": 0.001}}')


def _colmap_binary(folder: Path) -> None:
    write_colmap_binary(folder / "sparse" / "0", [(f"{c.name}.png", c, "OPENCV") for c in rig(NAMES)], POINTS)
    _pictures(folder)


def _colmap_text(folder: Path) -> None:
    write_colmap_text(folder / "sparse" / "0", [(f"{c.name}.png", c, "RADIAL") for c in rig(NAMES)], POINTS)
    _pictures(folder)


def _transforms(folder: Path) -> None:
    write_transforms(folder, [f"images/{name}.png" for name in NAMES], rig(NAMES), camera_model="OPENCV")
    _pictures(folder)


def _caliscope(folder: Path) -> None:
    write_caliscope(folder, rig(("cam_0", "cam_1")), [[True, True], [True, False]])


@pytest.mark.long
@pytest.mark.parametrize(
    ("write", "file"),
    [
        (_n3dv, "poses_bounds.npy"),
        (_n3dv, "distortion.json"),
        (_colmap_binary, "sparse/0/cameras.bin"),
        (_colmap_binary, "sparse/0/images.bin"),
        (_colmap_binary, "sparse/0/points3D.bin"),
        (_colmap_text, "sparse/0/cameras.txt"),
        (_colmap_text, "sparse/0/images.txt"),
        (_colmap_text, "sparse/0/points3D.txt"),
        (_transforms, "transforms.json"),
        (_caliscope, "camera_array.toml"),
        (_caliscope, "timestamps.csv"),
    ],
)
def test_damage_is_accepted_or_refused(tmp_path: Path, write: Callable[[Path], None], file: str) -> None:
    write(tmp_path)
    path = tmp_path / file
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(120):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(0, len(damaged)))
            damaged[at : at + int(rng.integers(0, 6))] = PIECES[rng.integers(len(PIECES))]
        path.write_bytes(damaged)
        refused += _is_refused(tmp_path)
    assert refused > 0
    path.write_bytes(data)
    assert not _is_refused(tmp_path)


def _is_refused(folder: Path) -> bool:
    try:
        dataset = open_dataset(folder)
        dataset.points()
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017 - the sentence is one line, whatever is wrong
        return True
    assert all(np.isfinite(camera.intrinsics).all() for camera in dataset.cameras)
    return False
