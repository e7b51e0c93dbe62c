"""Pictures of a walk, each with its own time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from streamlod.core.calibration.walk import open_walk
from streamlod.core.errors import InputError
from tests.core.data.writers import copy_video, picture, read_back, write_video


def test_what_is_damaged_shifts_no_later_picture(tmp_path: Path) -> None:
    groups = {"g": "6", "x264-params": "scenecut=0"}
    write_video(tmp_path / "cam_0.mp4", [picture(0, t) for t in range(16)])
    write_video(tmp_path / "whole.mp4", [picture(1, t) for t in range(16)], options=groups)
    copy_video(tmp_path / "whole.mp4", tmp_path / "cam_1.mkv", damaged=8)
    (tmp_path / "whole.mp4").unlink()
    for footage, lost in zip(open_walk(tmp_path), ((), (8, 9, 10, 11)), strict=True):
        seen = [None if image is None else read_back(image)[1] for image in footage.pictures()]
        assert seen == [None if t in lost else t for t in range(16)]
        assert len(footage.times) == 16


def test_a_folder_with_one_video_is_told_that_a_rig_has_more(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [np.zeros((48, 64, 3), np.uint8)] * 3)
    with pytest.raises(InputError, match="holds one camera; a rig has 2 to"):
        open_walk(tmp_path)


def test_no_more_cameras_are_calibrated_than_a_rig_may_have(tmp_path: Path) -> None:
    write_video(tmp_path / "cam0.mp4", [np.zeros((48, 64, 3), np.uint8)] * 3)
    for number in range(1, 256):
        (tmp_path / f"cam{number}.mp4").hardlink_to(tmp_path / "cam0.mp4")
    with pytest.raises(InputError, match="holds 256 cameras; a rig has 2 to 255"):
        open_walk(tmp_path)
