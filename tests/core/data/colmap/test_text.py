"""COLMAP models in text: faults are named by file and line, and the habits of other programs are known."""

from __future__ import annotations

from pathlib import Path

import pytest

from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from tests.core.data.colmap.folders import NAMES, POINTS, one_instant
from tests.core.data.writers import picture, rig, write_colmap_text, write_picture


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cameras.txt", "PINHOLE", "OPENCV_FISHEYE", r"cameras\.txt: camera model OPENCV_FISHEYE is not supported"),
        ("cameras.txt", "80.0", "eighty", r"cameras\.txt: line 2: "),
        ("cameras.txt", "80.0", "", r"cameras\.txt: line 2: PINHOLE has 4 parameters, not 2"),
        ("cameras.txt", "80.0", "-80.0", "camera a: focal length must be positive"),
        ("cameras.txt", "80.0", "nan", "camera a: its intrinsics"),
        ("cameras.txt", "\n1 ", "\n9 ", "image a.png: was taken by camera 1, which does not exist"),
        ("cameras.txt", "80.0 48.0", "0.8 0.5", "camera a: its focal length is 0.8 for pictures of 96x64"),
        ("images.txt", " a.png", "", r"images\.txt: line 2: the picture's name is missing"),
        (
            "images.txt",
            "\n1 ",
            "\n1 7 0 0 0 0 0 4 1 a.png\n\n# ",
            r"images\.txt: image a\.png: its quaternion has length",
        ),
        ("images.txt", "\n1 ", "\n1 nan ", r"images\.txt: "),
    ],
)
def test_faults_in_text_models_are_named(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_colmap_text(tmp_path / "sparse", [("a.png", rig(["a"])[0], "PINHOLE")], POINTS)
    write_picture(tmp_path / "images" / "a.png", picture(0, 0))
    path = tmp_path / "sparse" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


@pytest.mark.parametrize("names", [NAMES, ("0000", "0001", "0002")], ids=["words", "numbers"])
def test_text_models_without_lines_of_observations(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Programs that know no observations leave out the line, empty or not, that follows each image."""
    write_colmap_text(tmp_path / "sparse", [(camera.name, camera, "PINHOLE") for camera in rig(names)], POINTS)
    path = tmp_path / "sparse" / "images.txt"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if len(line.split()) == 10))
    for index, name in enumerate(names):
        write_picture(tmp_path / "images" / f"{name}.png", picture(index, 0))
    assert open_dataset(tmp_path).names == names


def test_text_models_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_text)
    for file in (tmp_path / "sparse" / "0").iterdir():
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    dataset = open_dataset(tmp_path)
    points = dataset.points()
    assert dataset.names == NAMES
    assert points is not None
    assert len(points) == 2


def test_text_models_in_utf_16_say_so(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_text)
    cameras = tmp_path / "sparse" / "0" / "cameras.txt"
    cameras.write_text(cameras.read_text(), "utf-16")
    with pytest.raises(InputError, match=r"cameras\.txt: is UTF-16 text; save it as UTF-8"):
        open_dataset(tmp_path)
