"""COLMAP folders of many instants: which folders are instants, and when they were taken."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from tests.core.data.colmap.folders import NAMES, POINTS
from tests.core.data.writers import picture, read_back, rig, write_colmap_binary, write_colmap_text, write_picture


@pytest.mark.parametrize("layout", ["frame{:06d}/images", "frame{:06d}", "colmap_{}/images"])
def test_a_folder_an_instant(tmp_path: Path, layout: str) -> None:
    for t in range(11):  # more than ten: sorted as numbers
        folder = tmp_path / layout.format(t)
        for index, name in enumerate(NAMES):
            write_picture(folder / f"{name}.png", picture(index, t))
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / layout.format(0).split("/")[0] / "sparse" / "0", entries, POINTS)
    (tmp_path / layout.format(4) / "cam02.png").unlink()
    dataset = open_dataset(tmp_path)
    assert (dataset.frame_count, dataset.names) == (11, NAMES)
    for frame in dataset.frames(2):
        assert frame.present.tolist() == [True, frame.index != 4, True]
        for index in np.flatnonzero(frame.present):
            assert read_back(frame.images[index]) == (index, frame.index)
        assert frame.images[~frame.present].sum() == 0


def test_a_folder_frames_beside_the_model(tmp_path: Path) -> None:
    entries = [(f"{camera.name}.jpg", camera, "PINHOLE") for camera in rig(NAMES)]  # the pictures are .png
    write_colmap_text(tmp_path / "sparse" / "0", entries, POINTS)
    for t in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{t:04d}" / f"{name}.png", picture(index, t))
    dataset = open_dataset(tmp_path)
    assert [read_back(frame.images[2]) for frame in dataset.frames()] == [(2, 0), (2, 1), (2, 2)]


def test_a_number_without_pictures_leaves_a_gap_in_time(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for t in (7, 8, 11):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{t:04d}" / f"{name}.png", picture(index, t))
    (tmp_path / "frames" / "0009").mkdir()  # nothing was copied into it
    seen = [(frame.index, frame.time_ns, read_back(frame.images[2])) for frame in open_dataset(tmp_path).frames()]
    assert seen == [(0, 0, (2, 7)), (1, 33333333, (2, 8)), (2, 133333333, (2, 11))]
    assert "2 instants have no pictures, after 0008" in caplog.text


@pytest.mark.parametrize("damage", ["cut", "garbage", "empty", "no pixels"])
def test_a_damaged_picture_costs_one_cameraone_instant(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    for instant in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{instant:04d}" / f"{name}.png", picture(index, instant))
    bad = tmp_path / "frames" / "0001" / "cam02.png"
    whole = bad.read_bytes()
    spoilt = bytearray(whole)
    spoilt[whole.index(b"IDAT") + 4 : whole.index(b"IDAT") + 44] = bytes(40)
    bad.write_bytes({"cut": whole[:-500], "garbage": b"x" * 500, "empty": b"", "no pixels": bytes(spoilt)}[damage])
    frames = list(open_dataset(tmp_path).frames())
    assert [frame.present.tolist() for frame in frames] == [[True] * 3, [True, False, True], [True] * 3]
    np.testing.assert_array_equal(frames[1].images[2], picture(2, 1))
    assert [record.message.count("0001/cam02.png") for record in caplog.records if "missing at" in record.message] == [
        1
    ]


def test_a_folder_of_pictures_a_camera_is_told_where_later_instants_belong(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    entries = [(f"{camera.name}/0000.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    for number, name in enumerate(NAMES):
        for instant in range(2):
            write_picture(tmp_path / "images" / name / f"{instant:04d}.png", picture(number, instant))
    with caplog.at_level(logging.WARNING):
        open_dataset(tmp_path)
    assert "put those of each instant into a folder frames/0000" in caplog.text
    caplog.clear()
    for instant in range(2):
        (tmp_path / "frames" / f"{instant:04d}").mkdir(parents=True)
        for number, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{instant:04d}" / name / "0000.png", picture(number, instant))
    with caplog.at_level(logging.WARNING):
        frames = list(open_dataset(tmp_path).frames())
    assert [[read_back(image) for image in frame.images] for frame in frames] == [
        [(number, instant) for number in range(len(NAMES))] for instant in range(2)
    ]
    assert "each camera has a folder" not in caplog.text


@pytest.mark.parametrize("stray", ["__MACOSX", "thumbs", "0001_old", ".trash"])
def test_stray_folders_are_no_instants(tmp_path: Path, stray: str) -> None:
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for folder in ("0000", "0001", "0002", stray):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / folder / f"{name}.png", picture(index, 0))
    assert open_dataset(tmp_path).frame_count == 3


def test_many_stray_folders_beside_few_instants_are_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As network drives and other systems leave behind."""
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "frames" / "0000" / f"{name}.png", picture(index, 0))
    for folder in ("@eaDir", "$RECYCLE.BIN", "lost+found"):
        (tmp_path / "frames" / folder).mkdir()
    assert [frame.present.all() for frame in open_dataset(tmp_path).frames()] == [True]
    assert "@eaDir" in caplog.text


def test_stray_folders_beside_instants_with_models_are_no_instants(tmp_path: Path) -> None:
    for t in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / f"t{t}" / "images" / f"{name}.png", picture(index, t))
    write_colmap_text(tmp_path / "t0" / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    (tmp_path / "video").mkdir()
    (tmp_path / "__MACOSX").mkdir()
    dataset = open_dataset(tmp_path)
    assert [read_back(frame.images[2]) for frame in dataset.frames()] == [(2, 0), (2, 1), (2, 2)]
