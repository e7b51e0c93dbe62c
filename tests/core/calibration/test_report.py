"""Sentences of a calibration's report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.calibration.report import advice_of
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
