"""What `check` says of live training without a graphics card."""

import re

import numpy as np
import pytest

from streamlod.core.camera import Camera, pinhole
from streamlod.server.cli.pace import judged_pace, later_frame_seconds


def filming(width: int, height: int) -> Camera:
    return pinhole("phone", (width, width), (width / 2, height / 2), (width, height), np.eye(4))


def test_times_are_near_those_measured_on_two_cores() -> None:
    assert later_frame_seconds(640 * 360, 1) == pytest.approx(4.4)
    assert 9 <= later_frame_seconds(1280 * 720, 1) <= 13
    assert later_frame_seconds(1280 * 720, 1) / later_frame_seconds(1280 * 720, 2) == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize(("width", "height", "times"), [(1280, 720, 2), (720, 1280, 2), (1920, 1080, 3)])
def test_large_pictures_are_advised_to_be_made_smaller(width: int, height: int, times: int) -> None:
    (finding,) = judged_pace([filming(640, 360), filming(width, height)], 2)
    assert f"{width}x{height}" in finding.sentence
    assert f"`--downscale {times}`" in finding.sentence
    slow, fast = (float(found) for found in re.findall(r"about ([\d.]+) s", finding.sentence))
    assert slow > 1.9 * fast


def test_small_pictures_are_not_and_many_cores_are_fast_enough() -> None:
    assert "downscale" not in judged_pace([filming(640, 360)], 2)[0].sentence
    assert judged_pace([filming(640, 360)], 16) == []
