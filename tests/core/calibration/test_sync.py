"""First time offsets, from the paths along which cameras see the board go."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.calibration.sync import first_offsets
from streamlod.core.calibration.track import Track
from tests.core.calibration.walks import BOARD, rig, walked


def test_fast_cameras_started_seconds_apart_are_found() -> None:
    """From one picture to the next of 30 a second a board moves little more than its place is uncertain."""
    truth, offsets = rig(2, arc=50.0), np.array([0.0, 4.4])
    tracks = walked(truth, fps=30.0, noise=0.25, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre)
    assert found[1] - found[0] == pytest.approx(4.4, abs=0.1)


@pytest.mark.parametrize(("noise", "fps"), [(0.5, 15.0), (0.2, 6.0)])
def test_first_offsets_are_good_to_half_a_picture(noise: float, fps: float) -> None:
    """Speeds of boards with noise of half a pixel were told apart from others by chance, by up to seven pictures."""
    truth, offsets = rig(3, arc=100.0), np.array([0.0, 0.22, -0.18])
    tracks = walked(truth, seconds=30, fps=fps, noise=noise, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre)
    assert np.abs(found - found[0] - offsets).max() < 0.5 / fps


def test_a_board_that_one_camera_sees_lie_still_tells_no_offset() -> None:
    truth = rig(2, arc=50.0)
    tracks = walked(truth, seconds=20, noise=0.1)
    still = Track(tracks[1].camera, tracks[1].size, tracks[1].times, np.tile(tracks[1].corners[:1], (300, 1, 1)))
    found = first_offsets([tracks[0], still], truth.lenses, BOARD.corners, BOARD.centre)
    assert found.tolist() == [0.0, 0.0]
