"""Quality to expect at the cameras and between them, from the widest gap between neighbours."""

from __future__ import annotations

from dataclasses import dataclass

from streamlod.core.calibration.checks.finding import RigFinding, fact


@dataclass(frozen=True, slots=True)
class Expectation:
    """Quality that was measured where neighbouring cameras are `most` degrees apart or less.

    Attributes:
        at: dB at the cameras. word, between: how sharp it is half way between neighbours, and dB there.
    """

    most: float
    at: str
    word: str
    between: str


# First frames of rendered scenes, preset `live`, ranges over scenes, each the mean of its cameras and half way between
# nearest neighbours (docs/history/log.md, "Quality by the gap between cameras"). Degrees are as in `coverage`.
_MEASURED = (
    Expectation(10, "34 to 36", "sharp", "33 to 34"),  # 7: `room` with 6 cameras
    Expectation(17, "35 to 41", "sharp to soft", "28 to 38"),  # 11 to 16: 6 cameras of four kinds, wide:room:12
    Expectation(28, "36 to 38", "soft", "27 to 31"),  # 22: wide:room:20, wide:bright:20
    Expectation(46, "35 to 40", "blurred", "23 to 27"),  # 36 to 46: the same at 35, two kinds with 3 cameras
    Expectation(float("inf"), "36 to 40", "badly blurred", "19 to 25"),  # 50: wide: of six kinds
)


def expected(degrees: float, names: str) -> RigFinding:
    """The quality to expect of a rig whose widest gap, between the cameras `names`, is so wide."""
    found = next(each for each in _MEASURED if degrees <= each.most)
    return fact(
        f"expect sharp pictures at the cameras ({found.at} dB) and {found.word} ones half way between {names} "
        f"({found.between} dB): so it was measured in rendered scenes; four webcams had 31 to 37 dB at the cameras"
    )
