"""Names of pictures in COLMAP models, of any program and system, lead to one file each and to no other place."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import pytest

from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from tests.core.data.colmap.folders import NAMES, POINTS, Writer, both_formats, one_instant
from tests.core.data.writers import picture, read_back, rig, write_colmap_binary, write_colmap_text, write_picture


def test_names_that_lead_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    write_picture(tmp_path / "secret.png", picture(0, 0))
    write_picture(tmp_path / "data" / "images" / "b.png", picture(0, 0))
    entries = [("../../secret.png", rig(["a"])[0], "PINHOLE"), ("b.png", rig(["b"])[0], "PINHOLE")]
    write_colmap_binary(tmp_path / "data" / "sparse", entries, POINTS)
    assert open_dataset(tmp_path / "data").names == ("b",)


def test_pictures_may_be_links_and_one_that_leads_to_itself_is_missing(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_binary)
    images = tmp_path / "images"
    (images / "cam00.png").rename(tmp_path / "elsewhere.png")
    (images / "cam00.png").symlink_to(tmp_path / "elsewhere.png")
    (images / "cam02.png").unlink()
    (images / "cam02.png").symlink_to("cam02.png")
    dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (("cam00", "cam10"), ("cam02.png",))
    assert read_back(next(iter(dataset.frames())).images[0]) == (0, 0)


def test_one_file_never_serves_several_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Folders of cameras that were copied into one leave a single 0000.png."""
    cameras = rig(NAMES)
    entries = [(f"{camera.name}/0000.png", camera, "PINHOLE") for camera in cameras]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    write_picture(tmp_path / "images" / "0000.png", picture(0, 0))
    with pytest.raises(InputError, match=r"holds none of the pictures .*: cam00/0000\.png, cam02/0000\.png"):
        open_dataset(tmp_path)
    write_picture(tmp_path / "images" / "cam02" / "0000.JPG", picture(1, 0))  # found in its folder, converted
    write_picture(tmp_path / "images" / "cam10" / "0000.png", picture(2, 0))
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert dataset.names == ("cam00/0000", "cam02/0000", "cam10/0000")
    (frame,) = dataset.frames()
    assert [read_back(image) for image in frame.images] == [(0, 0), (1, 0), (2, 0)]


def test_spaces_in_names_are_kept(tmp_path: Path) -> None:
    names = ["left  cam.png", "right cam 2.png"]
    write_colmap_text(tmp_path / "sparse", [(n, c, "PINHOLE") for n, c in zip(names, rig("ab"), strict=True)], POINTS)
    for index, name in enumerate(names):
        write_picture(tmp_path / "images" / name, picture(index, 0))
    assert open_dataset(tmp_path).names == ("left  cam", "right cam 2")


@both_formats
def test_names_that_are_not_utf8_lead_to_their_files(tmp_path: Path, write: Writer) -> None:
    one_instant(tmp_path, write)
    kind = "bin" if write is write_colmap_binary else "txt"
    model = tmp_path / "sparse" / "0" / f"images.{kind}"
    model.write_bytes(model.read_bytes().replace(b"cam02.png", b"c\xfcm2.png"))
    (tmp_path / "images" / "cam02.png").rename(tmp_path / "images" / os.fsdecode(b"c\xfcm2.png"))
    dataset = open_dataset(tmp_path)
    assert sorted(dataset.names) == ["cam00", "cam10", "c\ufffdm2"]
    (frame,) = dataset.frames()
    assert {name: read_back(image)[0] for name, image in zip(dataset.names, frame.images, strict=True)} == {
        "cam00": 0,
        "cam10": 2,
        "c\ufffdm2": 1,
    }


def test_a_missing_picture_whose_name_is_not_utf8_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    one_instant(tmp_path, write_colmap_binary)
    model = tmp_path / "sparse" / "0" / "images.bin"
    model.write_bytes(model.read_bytes().replace(b"cam02.png", b"c\xfcm2.png"))
    with caplog.at_level(logging.WARNING):
        assert open_dataset(tmp_path).names == ("cam00", "cam10")
    assert "names that are not UTF-8" in caplog.text


@both_formats
def test_backslashes_of_windows_are_slashes(tmp_path: Path, write: Writer) -> None:
    entries = [(rf"left\{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write(tmp_path / "sparse" / "0", entries, POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "images" / "left" / f"{name}.png", picture(index, 0))
    dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (NAMES, ())


def test_long_names_are_cut_to_what_a_stream_can_hold(tmp_path: Path) -> None:
    cameras = rig(["摄像机机位" * 5 + str(index) for index in range(3)])
    write_colmap_binary(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in cameras], POINTS)
    for index, camera in enumerate(cameras):
        write_picture(tmp_path / "images" / f"{camera.name}.png", picture(index, 0))
    names = open_dataset(tmp_path).names
    assert [name[-1] for name in names] == ["0", "1", "2"]
    assert all(len(name.encode()) <= 64 and "\ufffd" not in name for name in names)
