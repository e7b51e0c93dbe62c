"""First time offsets, from the paths along which cameras see the board go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.core.calibration.sync import first_offsets
from streamlod.core.calibration.track import Track
from tests.core.calibration.walks import BOARD, rig, stopping, walked


def test_fast_cameras_started_seconds_apart_are_found() -> None:
    """From one picture to the next of 30 a second a board moves little more than its place is uncertain."""
    truth, offsets = rig(2, arc=50.0), np.array([0.0, 4.4])
    tracks = walked(truth, fps=30.0, noise=0.25, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre).seconds
    assert found[1] - found[0] == pytest.approx(4.4, abs=0.1)


@pytest.mark.parametrize(("noise", "fps"), [(0.5, 15.0), (0.2, 6.0)])
def test_first_offsets_are_good_to_half_a_picture(noise: float, fps: float) -> None:
    """Speeds of boards with noise of half a pixel were told apart from others by chance, by up to seven pictures."""
    truth, offsets = rig(3, arc=100.0), np.array([0.0, 0.22, -0.18])
    tracks = walked(truth, seconds=30, fps=fps, noise=noise, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre).seconds
    assert np.abs(found - found[0] - offsets).max() < 0.5 / fps


def test_a_board_that_one_camera_sees_lie_still_tells_no_offset() -> None:
    truth = rig(2, arc=50.0)
    tracks = walked(truth, seconds=20, noise=0.1)
    still = Track(tracks[1].camera, tracks[1].size, tracks[1].times, np.tile(tracks[1].corners[:1], (300, 1, 1)))
    found = first_offsets([tracks[0], still], truth.lenses, BOARD.corners, BOARD.centre).seconds
    assert found.tolist() == [0.0, 0.0]


def test_sound_stands_in_where_a_camera_sees_the_board_lie_still_or_hardly() -> None:
    truth = rig(3, arc=50.0)
    tracks = walked(truth, seconds=20, noise=0.1)
    still = replace(tracks[1], corners=np.tile(tracks[1].corners[:1], (300, 1, 1)))
    blind = replace(tracks[2], corners=tracks[2].corners.copy())
    blind.corners[8:] = np.nan
    heard = np.array([-3.0, -3.2, 9.5])
    found = first_offsets([tracks[0], still, blind], truth.lenses, BOARD.corners, BOARD.centre, heard)
    assert found.seconds == pytest.approx([0.0, -0.2, 12.5])
    assert found.by_sound(0).tolist() == [False, True, True]
    assert found.held(1).tolist() == [True, False, True]
    some = first_offsets([tracks[0], still, blind], truth.lenses, BOARD.corners, BOARD.centre, heard * [1, 1, np.nan])
    assert some.seconds[:2] == pytest.approx([0.0, -0.2])
    assert some.held(0).tolist() == [False, True, False]


@pytest.mark.parametrize("off", [0.0, 0.1, -4.0])
def test_where_a_board_is_walked_it_is_believed_and_sound_is_not(off: float) -> None:
    truth, offsets = rig(2, arc=50.0), np.array([0.0, 14.4])
    tracks = walked(truth, noise=0.25, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre, offsets + np.array([0.0, off]))
    assert found.seconds == pytest.approx(offsets, abs=0.03)
    assert not found.by_sound(0).any()


def test_a_board_held_still_whenever_it_is_seen_is_not_believed() -> None:
    """Paths lie close for as long as it is held, and their best offset within that is chance."""
    truth, offsets = rig(2, arc=50.0), np.array([0.0, 2.1])
    tracks = stopping(truth, offsets)
    alone = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre)
    assert abs(alone.seconds[1] - 2.1) < 0.5
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre, offsets + np.array([0.0, 0.004]))
    assert found.seconds == pytest.approx([0.0, 2.104])
    assert found.by_sound(0).tolist() == [False, True]
