"""Times that live training takes on a computer without a graphics card, as `check` tells them."""

from __future__ import annotations

from collections.abc import Sequence

from streamlod.core.calibration.checks.finding import RigFinding, weak
from streamlod.core.camera import Camera

# A later frame of the preset `live` took 4.4 CPU seconds at 640x360 and 9 to 13 at 1280x720, four to six cameras; two
# cores took 1.7 times less time than one (docs/history/log.md).
_CPU_SECONDS, _PIXELS, _GROWTH, _SHARED = 4.4, 640 * 360, 0.6, 0.75
_SMOOTH_SECONDS = 1.0  # between two pictures: nobody has to be warned
_ROWS = 360  # of pictures that suit a few cores


def judged_pace(cameras: Sequence[Camera], cores: int) -> list[RigFinding]:
    """Findings about live training on `cores` without a graphics card: how slow it is, and what would be faster.

    Args:
        cameras: of the rig, in the size in which they film.
    """
    width, height = max(((camera.width, camera.height) for camera in cameras), key=lambda size: size[0] * size[1])
    seconds = later_frame_seconds(width * height, cores)
    if seconds <= _SMOOTH_SECONDS:
        return []
    sentence = (
        f"without a graphics card that training can use, {cores} cores train one frame of {width}x{height} in about "
        f"{_told(seconds)} s while live, so that people are shown in jumps"
    )
    times = round(min(width, height) / _ROWS)
    if times > 1:
        faster = later_frame_seconds(width * height // times**2, cores)
        sentence += f"; `--downscale {times}` at the end of `streamlod serve` makes that about {_told(faster)} s"
    return [weak(sentence)]


def later_frame_seconds(pixels: int, cores: int) -> float:
    """Wall time of a later frame by the pixels of one camera's picture, rough."""
    return _CPU_SECONDS * float((pixels / _PIXELS) ** _GROWTH / cores**_SHARED)


def _told(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds > 1 else f"{seconds:.1f}"
