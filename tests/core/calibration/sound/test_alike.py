"""Time between clocks by what microphones heard."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.calibration.sound.alike import RATE, heard_later, heard_offsets, rises
from tests.core.calibration.sound.claps import claps


def heard(begin: float, seed: int, gain: float = 1.0, noise: float = 60.0, seconds: float = 12.0) -> Float64:
    return rises(claps(begin, seconds, seed, gain=gain, noise=noise))


@pytest.mark.parametrize("late", [0.0, 0.0125, 0.25, -0.4])
def test_a_clap_tells_how_far_two_cameras_are_apart(late: float) -> None:
    assert heard_later(heard(0.0, 1), heard(-late, 2, 0.2), 0.8) == pytest.approx(late, abs=0.002)


def test_noise_beats_and_silence_tell_nothing() -> None:
    one, other = (rises(np.random.default_rng(n).normal(0, 500, (8 * RATE, 1)).astype(np.int16)) for n in range(2))
    beat = (np.arange(8 * RATE) % (RATE // 4) < 80).astype(np.int16)[:, None] * 8000
    for reach in (0.8, 60.0):
        assert heard_later(one, other, reach) is None
        assert heard_later(rises(beat), rises(beat), reach) is None
        assert heard_later(one, np.zeros_like(other), reach) is None
        assert heard_later(one[:100], other[:100], reach) is None


@pytest.mark.parametrize("begins", [[0.0, 0.3], [0.0, 3.7], [2.5, -27.0], [0.0, 70.0]])
def test_recordings_begun_up_to_a_minute_apart_are_found(begins: list[float]) -> None:
    """Beyond the reach nothing is said, and no clap that only one of them heard is taken for the other's."""
    at = (75.1, 76.45, 77.2)
    found = heard_offsets([rises(claps(begin, 110.0, n, at=at)) for n, begin in enumerate(begins)], 60.0)
    if abs(begins[1] - begins[0]) > 60:
        assert np.isnan(found).all()
    else:
        assert found == pytest.approx(np.array(begins) - begins[0], abs=0.002)


def test_a_dead_microphone_hides_no_other_and_a_third_joins_two_that_do_not_hear_each_other() -> None:
    """As where the first camera is muted, and one hears what two others hear, each a part of it."""
    early, late = (3.1, 4.6, 5.0), (8.3, 8.97, 10.6)
    all_of_it, first, last = (rises(claps(2.0, 12.0, n, at=at)) for n, at in enumerate((early + late, early, late)))
    dead, shut = np.zeros(0), np.zeros_like(first)
    found = heard_offsets([dead, first, shut, last, all_of_it], 60.0)
    assert np.isnan(found).tolist() == [True, False, True, False, False]
    assert found[[1, 3, 4]] == pytest.approx(0.0, abs=0.002)


def test_nothing_heard_is_nothing_told() -> None:
    assert heard_offsets([], 60.0).tolist() == []
    assert np.isnan(heard_offsets([heard(0, 1), np.zeros(0)], 60.0)).all()
