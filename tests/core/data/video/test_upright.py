"""Turned and mirrored videos, as FFmpeg shows them."""

from __future__ import annotations

import gc
import subprocess
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.data.video import probe_video, read_video
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from tests.core.data.writers import picture, put_display_matrix, read_back, write_video, write_video_clip

TURNS = [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)]
MIRRORED = [(-1, 0, 0, 1), (1, 0, 0, -1), (0, 1, 1, 0), (0, -1, -1, 0)]


def _corners() -> np.ndarray:
    """[48,64,3]: another colour in each corner."""
    image = np.full((48, 64, 3), 90, np.uint8)
    image[:16, :16], image[:16, -16:] = (240, 20, 20), (20, 240, 20)
    image[-16:, :16] = (20, 20, 240)
    return image


@pytest.mark.parametrize("matrix", [(1, 0, 0, 1), *TURNS, *MIRRORED])
def test_pictures_are_shown_as_ffmpeg_shows_them(tmp_path: Path, matrix: tuple[float, ...]) -> None:
    video, still = tmp_path / "cam.mp4", tmp_path / "still.png"
    write_video(video, [_corners()])
    put_display_matrix(video, *matrix)
    subprocess.run(["ffmpeg", "-loglevel", "error", "-i", str(video), "-frames:v", "1", str(still)], check=True)
    expected = cv2.imread(str(still))
    assert expected is not None
    ((_, frame),) = read_video(video)
    assert upright(frame).shape == expected.shape
    assert np.abs(upright(frame).astype(int) - expected[..., ::-1]).max() < 12
    info = probe_video(video)
    assert (info.height, info.width) == expected.shape[:2]


def test_a_matrix_may_scale_or_say_nothing(tmp_path: Path) -> None:
    video = tmp_path / "cam.mp4"
    write_video(video, [_corners()])
    ((_, plain),) = read_video(video)
    for matrix, quarters in (((0, 0, 0, 0), 0), ((0, 2.5, -0.5, 0.001), 3)):
        put_display_matrix(video, *matrix)
        ((_, frame),) = read_video(video)
        np.testing.assert_array_equal(upright(frame), np.rot90(upright(plain), quarters))


def test_a_picture_is_freed_with_its_last_user(tmp_path: Path) -> None:
    """Without a search for cycles, which is rare where few objects are made: pictures are megabytes."""
    write_video(tmp_path / "cam.mp4", [_corners()] * 3)
    put_display_matrix(tmp_path / "cam.mp4", *TURNS[0])
    gc.collect()
    gc.disable()
    try:
        sizes = [upright(frame).shape for _, frame in read_video(tmp_path / "cam.mp4")]
        kept = [each for each in gc.get_objects() if isinstance(each, av.VideoFrame)]
    finally:
        gc.enable()
    assert sizes == [(64, 48, 3)] * 3
    assert not kept


def test_a_picture_that_is_turned_by_another_angle_is_refused(tmp_path: Path) -> None:
    write_video_clip(tmp_path, ("cam00",), frames=1)
    put_display_matrix(tmp_path / "cam00.mp4", 0.8, 0.6, -0.6, 0.8)
    with pytest.raises(InputError, match=r"cam00\.mp4: picture: is turned by no quarter"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (0, -1, 1, 0)])
def test_cameras_that_stood_on_their_side_have_upright_pictures_and_sizes(
    tmp_path: Path, matrix: tuple[float, ...]
) -> None:
    """The calibration is that of upright pictures, 96x64; one camera stores 64x96."""
    write_video_clip(tmp_path, ("cam00", "cam01"), frames=2)
    quarters = 1 if matrix[1] > 0 else -1
    stored = [np.rot90(picture(1, t), quarters) for t in range(2)]
    write_video(tmp_path / "cam01.mp4", stored)
    put_display_matrix(tmp_path / "cam01.mp4", *matrix)
    dataset = open_dataset(tmp_path)
    assert {(c.width, c.height) for c in dataset.cameras} == {(96, 64)}
    for index, frame in enumerate(dataset.frames()):
        assert [read_back(image) for image in frame.images] == [(0, index), (1, index)]
        assert np.abs(frame.images[1].astype(int) - picture(1, index)).max() < 16
