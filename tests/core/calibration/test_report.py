"""Sentences of a calibration's report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.calibration.report import advice_of
from streamlod.core.calibration.sound.report import sound_advice
from tests.core.calibration.test_files import calibration


def test_cameras_with_uneven_times_are_named_in_one_sentence() -> None:
    found = calibration(["left", "middle", "right"], [0.0, 0.0, 0.0], (96, 64))
    sentences = list(advice_of(replace(found, uneven=np.array([0.011, 0.001, 0.02]))))
    (uneven,) = [sentence for sentence in sentences if "than their times say" in sentence]
    assert uneven.startswith("left and right: pictures were taken up to 20 ms earlier or later")
    assert not any("than their times say" in sentence for sentence in advice_of(found))


def test_cameras_with_rolling_shutters_are_named_in_one_sentence() -> None:
    found = calibration(["left", "middle", "right"], [0.0, 0.0, 0.0], (96, 64))
    readouts = np.array([[0.0, 0.021], [0.001, -0.002], [-0.029, 0.0]])
    (read,) = [each for each in advice_of(replace(found, readouts=readouts)) if "line by line" in each]
    assert read.startswith("left and right: a picture is read line by line in up to 29 ms")
    assert not any("line by line" in sentence for sentence in advice_of(found))


def test_offsets_by_sound_that_are_far_from_the_boards_are_named() -> None:
    found = calibration(["left", "middle", "right", "mute"], [0.0, 1.0, -2.0, 0.5], (96, 64))
    heard = replace(found, heard=np.array([7.0, 8.01, 5.12, np.nan]))
    wrong, fact = sound_advice(heard)
    assert wrong.startswith(
        "right: sound puts its clock 110 ms, 1.1 frames, later than the board does, whose offset is"
    )
    assert fact.startswith("by what left, middle and right heard, their offsets are the board's to 110 ms, 1.1 frames")
    replaced = replace(heard, heard=np.array([7.0, 8.01, 5.04, np.nan]))
    (fact,) = sound_advice(replaced)
    assert "to 30 ms, 0.3 frames; the board's are used" in fact
    assert list(sound_advice(found)) == []


def test_a_camera_whose_offset_rests_on_sound_is_named_and_not_compared() -> None:
    found = calibration(["left", "middle", "right"], [0.0, 1.0, -2.0], (96, 64))
    by_sound = np.array([False, False, True])
    told, fact = sound_advice(replace(found, heard=np.array([0.0, 1.0, 3.0]), by_sound=by_sound))
    assert told.startswith("right: the offset is that of sound, good to 3 ms a metre")
    assert fact.startswith("by what left and middle heard, their offsets are the board's to 0 ms")
