"""Findings about cameras that hear at another time than others."""

from __future__ import annotations

from streamlod.core.calibration.checks.heard import judged
from streamlod.core.calibration.sound.alike import rises
from tests.core.calibration.sound.claps import claps


def test_the_camera_that_hears_at_another_time_is_named_and_distance_is_no_fault() -> None:
    late = {"a": 0.08, "b": 0.0, "c": 0.009}
    sounds = {name: rises(claps(-each, 12.0, n, gain=0.5)) for n, (name, each) in enumerate(late.items())}
    wrong, fact = judged(sounds, 30.0)
    assert wrong.severity == "weak"
    assert wrong.sentence.startswith("a hears the same 7")
    assert "later than most" in wrong.sentence
    assert "2.1 frames off" in wrong.sentence
    assert fact.sentence.startswith("by what a, b and c heard, their times agree to 7")
    (fact,) = judged({name: sounds[name] for name in "bc"}, 30.0)
    assert fact.severity == "fact"
    assert list(judged({"b": sounds["b"]}, 30.0)) == []


def test_of_two_cameras_the_whole_difference_is_told_and_a_dead_first_one_hides_none() -> None:
    sounds = {"a": rises(claps(0.0, 12.0, 1, gain=0.0, noise=0.0)), "b": rises(claps(0.0, 12.0, 2))}
    wrong, fact = judged(sounds | {"c": rises(claps(-0.12, 12.0, 3))}, 25.0)
    assert wrong.sentence.startswith("c hears the same 120 ms later than most cameras, so its pictures are 3.0 frames")
    assert fact.sentence.startswith("by what b and c heard, their times agree to 120 ms")
