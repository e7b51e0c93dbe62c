"""Recordings appear when they are complete."""

from __future__ import annotations

import math
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from streamlod.client.recorder import open_recorder, write_png
from streamlod.core.arrays import UInt8
from streamlod.core.errors import InputError
from tests.small_disk import files_up_to, mounted_disk


def picture(number: int, size: tuple[int, int] = (48, 64)) -> UInt8:
    rows, columns = np.mgrid[: size[0], : size[1]]
    return np.stack([rows * 4 + number, columns * 3, np.full(size, 40 * number)], axis=2).astype(np.uint8)


def test_png_folder_keeps_every_value(tmp_path: Path) -> None:
    with open_recorder(tmp_path / "a" / "b", 30) as recorder:
        for number in range(3):
            recorder.add(picture(number))
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == [f"0000{n}.png" for n in range(3)]
    read = cv2.imread(str(tmp_path / "a" / "b" / "00002.png"))
    np.testing.assert_array_equal(read[..., ::-1], picture(2))


def test_mp4_holds_the_pictures_at_their_rate(tmp_path: Path) -> None:
    with open_recorder(tmp_path / "a.mp4", 29.97) as recorder:
        for number in range(5):
            recorder.add(picture(number, (49, 65)))
        assert not (tmp_path / "a.mp4").exists()
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert abs(float(stream.average_rate or 0) - 29.97) < 0.01
    assert len(frames) == 5
    assert np.abs(frames[3].astype(int) - picture(3)[:48, :64]).mean() < 6
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_paths_may_be_text(tmp_path: Path) -> None:
    write_png(str(tmp_path / "a.png"), picture(1))
    with open_recorder(str(tmp_path / "b.mp4"), 30) as recorder:
        recorder.add(picture(1))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.mp4"]


def test_a_picture_of_floats_is_not_written_as_black(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="picture must be an array of uint8, not float64"):
        write_png(tmp_path / "a.png", picture(1) / 255)
    with pytest.raises(ValueError, match="picture must have shape NxNx3, not 48x64"):
        write_png(tmp_path / "a.png", picture(1)[..., 0])
    assert list(tmp_path.iterdir()) == []


def test_an_error_leaves_no_video(tmp_path: Path) -> None:
    def record() -> None:
        with open_recorder(tmp_path / "a.mp4", 30) as recorder:
            recorder.add(picture(0))
            recorder.add(picture(1, (20, 20)))

    with pytest.raises(InputError, match="changed their size"):
        record()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("count", [2, 200])  # the disk is full at the end of the film, or amid it
def test_a_full_disk_is_told_by_the_films_name_and_leaves_nothing(tmp_path: Path, count: int) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)

    def film() -> None:
        with open_recorder(tmp_path / "a.mp4", 30) as recorder:
            for shift in range(count):
                recorder.add(np.roll(noise, 7 * shift, axis=1))

    with files_up_to(3000), pytest.raises(InputError, match=r"/a\.mp4: cannot be written \(File too large\)"):
        film()
    assert [*tmp_path.iterdir()] == []


def test_a_film_can_be_ended_when_the_disk_gets_full(tmp_path: Path) -> None:
    """Pictures are refused while there is room for those that the encoder holds, and for the index."""
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    with mounted_disk(tmp_path / "disk") as disk:
        recorder = open_recorder(disk / "a.mp4", 30)

        def add() -> None:
            for shift in range(10_000):
                recorder.add(np.roll(noise, 7 * shift, axis=1))

        with pytest.raises(InputError, match="the disk is full"):
            add()
        recorder.__exit__(None, None, None)
        assert [path.name for path in disk.iterdir()] == ["a.mp4"]
        assert (disk / "a.mp4").stat().st_size > 1_000_000
        with av.open(str(disk / "a.mp4")) as film:
            assert len(list(film.decode(video=0))) == recorder.count


def test_films_are_told_by_their_suffix_in_any_case(tmp_path: Path) -> None:
    with open_recorder(tmp_path / "a.MP4", 30) as recorder:
        recorder.add(picture(0))
    assert (tmp_path / "a.MP4").is_file()
    for name in ("a.mov", "a.AVI", "a.png"):
        with pytest.raises(InputError, match=r"is neither an \.mp4 file nor a folder"):
            open_recorder(tmp_path / name, 30)
    assert [path.name for path in tmp_path.iterdir()] == ["a.MP4"]


def test_a_film_of_single_pixels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two pixels a side"), open_recorder(tmp_path / "a.mp4", 30) as recorder:
        recorder.add(picture(0, (1, 1)))
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file" / "x.mp4", tmp_path / "file" / "x"):
        with pytest.raises(InputError, match="cannot be written"):
            open_recorder(out, 30)


@pytest.mark.parametrize("fps", [0, -30, math.nan, math.inf])
def test_what_is_no_rate_is_refused_before_a_file_is_made(tmp_path: Path, fps: float) -> None:
    with pytest.raises(InputError, match="fps: must be a number above 0"):
        open_recorder(tmp_path / "a" / "b.mp4", fps)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["film.mp4", "pictures"])
def test_what_is_no_picture_is_refused_alike_in_films_and_folders(tmp_path: Path, name: str) -> None:
    for wrong, kind in ((np.zeros((4, 4, 3)), TypeError), (np.zeros((4, 4), np.uint8), ValueError)):
        with pytest.raises(kind, match="picture must"), open_recorder(tmp_path / name, 30) as recorder:
            recorder.add(wrong)
    with pytest.raises(InputError, match="a side"), open_recorder(tmp_path / name, 30) as recorder:
        recorder.add(np.zeros((0, 4, 3), np.uint8))
