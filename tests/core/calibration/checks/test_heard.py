"""Time between cameras by what they heard."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.calibration.checks.heard import RATE, heard_later, judged, rises

Samples = np.ndarray


def room(late: float, gain: float, seed: int, seconds: float = 12.0) -> Samples:
    """Claps of a room with an echo, in a microphone with noise of its own."""
    claps, own = np.random.default_rng(0), np.random.default_rng(seed)
    sound = own.normal(0, 60, round(seconds * RATE))
    for at in claps.uniform(1, seconds - 1.5, 5):
        wave = claps.normal(0, 1, RATE // 2) * np.exp(-np.arange(RATE // 2) / (0.02 * RATE))
        for echo, share in ((0.0, 1.0), (0.013 + 0.004 * seed, 0.5)):
            begin = round((at + late + echo) * RATE)
            sound[begin : begin + len(wave)] += 9000 * gain * share * wave
    return np.clip(sound, -32768, 32767).astype(np.int16)[:, None]


@pytest.mark.parametrize("late", [0.0, 0.0125, 0.25, -0.4])
def test_a_clap_tells_how_far_two_cameras_are_apart(late: float) -> None:
    found = heard_later(rises(room(0.0, 1.0, 1)), rises(room(late, 0.2, 2)))
    assert found == pytest.approx(late, abs=0.002)


def test_noise_beats_and_silence_tell_nothing() -> None:
    one, other = (rises(np.random.default_rng(n).normal(0, 500, (8 * RATE, 1)).astype(np.int16)) for n in range(2))
    assert heard_later(one, other) is None
    beat = (np.arange(8 * RATE) % (RATE // 4) < 80).astype(np.int16)[:, None] * 8000
    assert heard_later(rises(beat), rises(beat)) is None
    assert heard_later(one, np.zeros_like(other)) is None
    assert heard_later(one[:100], other[:100]) is None


def test_the_camera_that_hears_at_another_time_is_named_and_distance_is_no_fault() -> None:
    sounds = {name: room(late, 0.5, n) for n, (name, late) in enumerate({"a": 0.08, "b": 0.0, "c": 0.009}.items())}
    wrong, fact = judged({name: rises(each) for name, each in sounds.items()}, 30.0)
    assert wrong.severity == "weak"
    assert wrong.sentence.startswith("a hears the same 7")
    assert "later than most" in wrong.sentence
    assert "2.1 frames off" in wrong.sentence
    assert fact.sentence.startswith("by what a, b and c heard, their times agree to 7")
    (fact,) = judged({name: rises(sounds[name]) for name in "bc"}, 30.0)
    assert fact.severity == "fact"
    assert list(judged({"b": rises(sounds["b"])}, 30.0)) == []
