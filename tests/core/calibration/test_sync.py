"""First time offsets, from how fast cameras see the board move."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.calibration.sync import first_offsets
from tests.core.calibration.walks import BOARD, rig, walked


def test_fast_cameras_started_seconds_apart_are_found() -> None:
    """From one picture to the next of 30 a second a board moves little more than its place is uncertain."""
    truth, offsets = rig(2, arc=50.0), np.array([0.0, 4.4])
    tracks = walked(truth, fps=30.0, noise=0.25, offsets=offsets)
    found = first_offsets(tracks, truth.lenses, BOARD.corners, BOARD.centre)
    assert found[1] - found[0] == pytest.approx(4.4, abs=0.1)
