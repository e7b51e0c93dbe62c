"""Binary COLMAP models: sizes and counts in them are not believed."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from streamlod.core.data.colmap.model import read_model, read_points
from streamlod.core.errors import InputError
from tests.core.data.colmap.folders import NAMES, POINTS
from tests.core.data.writers import rig, write_colmap_binary


@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_a_binary_model_cut_at_any_byte_is_refused(tmp_path: Path, stem: str) -> None:
    write_colmap_binary(tmp_path, [(f"{c.name}.png", c, "OPENCV") for c in rig(NAMES[:2])], POINTS)
    path = tmp_path / f"{stem}.bin"
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=rf"{stem}\.bin: "):
            read_model(tmp_path)


def test_points_cut_at_any_byte_are_refused(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, [], POINTS)
    path = tmp_path / "points3D.bin"
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"points3D\.bin: "):
            read_points(tmp_path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_counts_are_not_believed(tmp_path: Path, stem: str) -> None:
    write_colmap_binary(tmp_path, [("a.png", rig(["a"])[0], "PINHOLE")], POINTS)
    path = tmp_path / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", 2**62) + path.read_bytes()[8:])
    with pytest.raises(InputError, match="claims 4611686018427387904 records"):
        read_points(tmp_path) if stem == "points3D" else read_model(tmp_path)
