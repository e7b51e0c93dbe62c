"""What cameras see, drawn in letters."""

from __future__ import annotations

import numpy as np

from streamlod.core.calibration.checks.coverage import coverage_of
from streamlod.core.calibration.checks.from_above import drawn_from_above
from streamlod.core.camera import Camera, look_at, pinhole

UP = np.array([0.0, 0, 1])


def camera(name: str, eye: np.ndarray, focal: float, *, turned: bool = False) -> Camera:
    """A camera that looks at the middle, upside down where `turned`."""
    pose = look_at(eye, np.zeros(3), UP)
    pose = np.diag([-1.0, -1, 1, 1]) @ pose if turned else pose
    return pinhole(name, (focal, focal), (160, 90), (320, 180), pose)


def test_how_many_cameras_see_each_place_is_drawn_from_above() -> None:
    """Three cameras at the corners of a triangle, one of them upside down."""
    eyes = [4 * np.array([np.cos(angle), np.sin(angle), 0.25]) for angle in np.radians([-150, -30, 90])]
    cameras = [camera(f"cam_{n}", eye, 400, turned=n == 1) for n, eye in enumerate(eyes)]
    title, *drawn, names = drawn_from_above(coverage_of(cameras), cameras).splitlines()
    assert title.startswith("from above")
    assert names.startswith("A cam_0, B cam_1, C cam_2; ")
    places = {
        letter: np.array([line.index(letter), 2 * row])
        for row, line in enumerate(drawn)
        for letter in "ABC"
        if letter in line
    }
    assert sorted(places) == ["A", "B", "C"]
    sides = [np.linalg.norm(places[one] - places[other]) for one, other in ("AB", "BC", "CA")]
    assert max(sides) < 1.15 * min(sides), "a letter is twice as tall as wide"
    middle = sum(places.values()) / 3
    column, row = (round(value) for value in (middle[0], middle[1] / 2))
    assert drawn[row][column] == "3"
    seen = "".join(drawn)
    assert min(seen.count(each) for each in "12.") > 5
    left_of_all = [line[0] for line in drawn]
    assert "3" not in left_of_all


def test_cameras_at_one_place_share_a_letter() -> None:
    one = camera("one", np.array([3.0, 0, 0]), 400)
    drawn = drawn_from_above(coverage_of([one, one]), [one, one]).splitlines()
    assert "*" in "".join(drawn[1:-1])
    assert max(len(line) for line in drawn[1:-1]) <= 60
    assert len(drawn) < 35
