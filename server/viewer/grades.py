"""How good the pictures of a thin viewer are, by how long they take. Pure arithmetic on given times, no I/O."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Grade:
    """How good a picture is: fraction of the size asked for, JPEG quality."""

    scale: float
    quality: int


GRADES = (Grade(1, 92), Grade(1, 80), Grade(0.75, 75), Grade(0.5, 70), Grade(0.35, 60), Grade(0.25, 50))


class GradeControl:
    """Chooses the grade from how long pictures take, from the begin of drawing to the viewer's acknowledgement.

    It gets coarser at once when a picture takes long, and finer after several quick pictures, if the next grade should
    still be quick. Pictures of a view that does not move may take longer.

    Attributes:
        moving: index of the grade while the view or the scene changes.
    """

    _SLOW, _QUICK, _REST, _MAX_REST = 0.25, 0.15, 1.5, 10.0  # seconds a picture
    _CALM = 5  # pictures

    def __init__(self) -> None:
        self.moving, self._calm = 1, 0
        self._cost = 0.0  # seconds for all pixels at grade 0, from the last picture

    def resting(self, shown: int) -> int:
        """Index of the grade to draw next when nothing changes, after a picture of grade `shown`: the finest one that
        is expected in time; where none is, the next finer one, whose time then tells more. So what rests gets the
        finest in the end, unless that takes so long that the connection would be at risk."""
        quick = (index for index in range(shown) if self._expected(index) <= self._REST)
        finer = next(quick, max(0, shown - 1))
        return finer if self._expected(finer) <= self._MAX_REST else shown

    def delivered(self, index: int, seconds: float) -> None:
        """A picture of grade `index` took `seconds`."""
        self._cost = seconds / _work(index)
        if index < self.moving:
            return  # a picture of a view at rest may take longer
        if seconds > self._SLOW:
            steps = 2 if seconds > 3 * self._SLOW else 1
            self.moving, self._calm = min(self.moving + steps, len(GRADES) - 1), 0
            return
        self._calm += 1
        if self._calm >= self._CALM and self.moving > 0 and self._expected(self.moving - 1) <= self._QUICK:
            self.moving, self._calm = self.moving - 1, 0

    def _expected(self, index: int) -> float:
        return self._cost * _work(index)


def _work(index: int) -> float:
    """The cost of a picture of a grade, relative to the first: its pixels, and bytes that grow with the quality."""
    grade = GRADES[index]
    return grade.scale**2 * (grade.quality / GRADES[0].quality) ** 2
