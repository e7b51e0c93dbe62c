"""Looks of each camera's pictures: how sharp, how bright, and whether they change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from streamlod.core.arrays import Bool, Float32, Float64, UInt8
from streamlod.core.calibration.checks.finding import RigFinding, fault, weak

_STRONG = 0.02  # part of the pixels that count as edges
_MIN_EDGES = 50
_WINDOW = 9  # pixels round an edge in which its contrast is measured
_BLURRED = 1.6  # times as wide as the edges of most cameras
_SMEARED = 1.7  # times as wide where it moves
_STOPS = 1.0
_DARK, _CLIPPED = 16.0, 0.1  # mean grey value; part of the pixels
_MOVED = 12  # grey levels
_FROZEN = 0.3  # mean grey levels between pictures that count as none
_MEDIAN = 5  # pictures, of which two show what moves in one place


@dataclass(frozen=True, slots=True)
class CameraLook:
    """The look of one camera's pictures.

    Attributes:
        camera: name.
        edge: width of sharp edges in pixels: 1 / (slope / contrast); NaN without edges.
        moving_edge: the same where pictures differ; NaN where too little moves.
        brightness: mean grey value, 0 to 255. clipped: part of the pixels that are white.
        change: mean absolute difference of successive pictures in grey levels; NaN of a single one.
    """

    camera: str
    edge: float
    moving_edge: float
    brightness: float
    clipped: float
    change: float


def look_of(camera: str, pictures: Sequence[UInt8]) -> CameraLook:
    """The look of one camera from its pictures [H,W,3], in order."""
    greys = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32) for picture in pictures]
    differences = [np.abs(b - a) for a, b in pairwise(greys)]
    moving = [_widths(grey, moved > _MOVED) for grey, moved in zip(greys[1:], differences, strict=True)]
    widths = np.concatenate([_widths(grey) for grey in greys])
    moved = np.concatenate(moving) if moving else np.zeros(0)
    return CameraLook(
        camera,
        float(np.median(widths)) if len(widths) else np.nan,
        float(np.median(moved)) if len(moved) >= _MIN_EDGES else np.nan,
        float(np.mean([grey.mean() for grey in greys])),
        float(np.mean([(picture >= 250).all(axis=2).mean() for picture in pictures])),
        float(np.mean([difference.mean() for difference in differences])) if differences else np.nan,
    )


def still(pictures: Sequence[UInt8]) -> UInt8:
    """The picture of what stands still in pictures [H,W,3] of one camera: their median, where there are enough for one.

    What moves shows its features elsewhere in another camera whose picture is some milliseconds older, as those of a
    board that is walked at few pictures a second, and makes cameras seem knocked that are not.
    """
    if len(pictures) < _MEDIAN:
        return pictures[len(pictures) // 2]
    return np.asarray(np.median(np.stack(pictures), axis=0), np.uint8)


def judged(looks: Sequence[CameraLook]) -> Iterator[RigFinding]:
    """Findings about cameras that look unlike the others."""
    edge = np.nanmedian([look.edge for look in looks]) if any(np.isfinite(x.edge) for x in looks) else np.nan
    middle = float(np.median([look.brightness for look in looks]))
    changes = np.array([look.change for look in looks])
    for look in looks:
        if look.brightness < _DARK:
            yield fault(
                f"{look.camera} is dark (mean {look.brightness:.0f} of 255): its lens is covered, "
                "or it needs more light"
            )
            continue
        stops = float(np.log2(look.brightness / max(middle, 1.0)))
        if abs(stops) > _STOPS:
            side = "darker" if stops < 0 else "brighter"
            yield weak(
                f"{look.camera} is {abs(stops):.1f} stops {side} than most: set all cameras to one "
                "exposure, and lock it"
            )
        if look.clipped > _CLIPPED:
            yield weak(f"{look.camera} is white in {100 * look.clipped:.0f} % of its picture: expose less")
        if look.edge > _BLURRED * edge:
            yield fault(
                f"{look.camera} is out of focus or dirty: its edges are {look.edge:.1f} pixels "
                f"wide, those of most cameras {edge:.1f}"
            )
        elif look.moving_edge > _SMEARED * look.edge:
            yield weak(
                f"{look.camera} smears what moves: its edges are {look.moving_edge:.1f} pixels wide "
                f"there, {look.edge:.1f} elsewhere; take a shorter exposure"
            )
        if look.change < _FROZEN and np.nanmedian(changes) > 3 * _FROZEN:
            yield fault(
                f"{look.camera} shows one picture all the time while others change: its clock or "
                "its stream stands still"
            )


def _widths(grey: Float32, where: Bool | None = None) -> Float64:
    """Widths in pixels of the strongest edges."""
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3) / 8, cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3) / 8
    slope = np.hypot(across, down)
    square = np.ones((_WINDOW, _WINDOW), np.uint8)
    contrast = cv2.dilate(grey, square) - cv2.erode(grey, square)
    strong = slope > max(2.0, float(np.quantile(slope, 1 - _STRONG)))
    if where is not None:
        strong &= where
    return np.asarray((contrast / np.maximum(slope, 1e-3))[strong], np.float64)
