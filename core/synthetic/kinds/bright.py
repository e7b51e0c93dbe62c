"""A bright room where nearly everything is plain: painted walls, glossy white furniture, a screen, big windows.

What such a room lacks is texture: where matching finds nothing to hold on to, first points are easily wrong.
"""

from __future__ import annotations

import math

import numpy as np

from streamlod.core.synthetic import movers as M
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.parts import Lamp, Part, Vector, ball, box, lamps, limb, tube, turn
from streamlod.core.synthetic.shapes import ROOM
from streamlod.core.synthetic.textures import numbers as T

_HALF = (3.3, 3.7, 1.4)
_MIDDLE = (0.0, 1.0, 1.4)
_BACK, _SIDE = _MIDDLE[1] + _HALF[1], _HALF[0]
_WHITE, _PALE, _GREY = (0.93, 0.93, 0.92), (0.80, 0.82, 0.82), (0.55, 0.57, 0.60)
_BLACK, _OAK = (0.05, 0.05, 0.06), (0.78, 0.62, 0.44)


def _still(generator: np.random.Generator) -> list[Part]:
    seeds = generator.integers(0, 1 << 20, 40).tolist()
    parts = [Part(ROOM, _HALF, np.array(_MIDDLE), T.SMOOTH_WALLS, _WHITE, seed=seeds[0], gloss=0.05)]
    parts += [
        box((0, _BACK - 0.01, 0.05), (_SIDE, 0.01, 0.05), T.SMOOTH, _WHITE),
        box((-0.2, 2.1, 0.004), (1.5, 1.0, 0.004), T.SMOOTH, (0.72, 0.74, 0.76), gloss=0.0),
    ]
    accent = (0.20 + float(generator.uniform(0, 0.2)), 0.42, 0.46)
    parts += (
        _windows(seeds[1:3]) + _table() + _sideboard(accent, seeds[3:9]) + _sofa(accent) + _near() + _plant(seeds[9:25])
    )
    parts += [
        tube((-1.0, 2.0, 2.35), 0.26, 0.07, T.GLOW, (0.96, 0.94, 0.90), seed=seeds[25]),
        limb(np.array([-1.0, 2.0, 2.42]), np.array([-0.9999, 2.0, 2.79]), 0.01, T.SMOOTH, _BLACK),
    ]
    return parts


def _windows(seeds: list[int]) -> list[Part]:
    """Two big ones: in the left wall and at the back on the right, frames included."""
    parts = [
        box((-_SIDE + 0.01, 2.2, 1.5), (0.01, 1.35, 0.95), T.VIEW, _WHITE, seed=seeds[0]),
        box((2.1, _BACK - 0.01, 1.5), (0.85, 0.01, 0.95), T.VIEW, _WHITE, seed=seeds[1]),
    ]
    for y in (0.85, 2.2, 3.55):
        parts.append(box((-_SIDE + 0.03, y, 1.5), (0.03, 0.03, 0.98), T.SMOOTH, _WHITE))
    for x in (1.25, 2.95):
        parts.append(box((x, _BACK - 0.03, 1.5), (0.03, 0.03, 0.98), T.SMOOTH, _WHITE))
    for z in (0.54, 2.46):
        parts.append(box((-_SIDE + 0.03, 2.2, z), (0.03, 1.38, 0.03), T.SMOOTH, _WHITE))
        parts.append(box((2.1, _BACK - 0.03, z), (0.88, 0.03, 0.03), T.SMOOTH, _WHITE))
    return parts


def _table() -> list[Part]:
    """A glossy white table with two chairs, a bowl and a closed laptop."""
    x, y = -1.0, 2.0
    parts = [box((x, y, 0.73), (0.75, 0.42, 0.02), T.SMOOTH, _WHITE, gloss=0.4, mirror=0.15)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            parts.append(box((x + 0.68 * sx, y + 0.36 * sy, 0.355), (0.025, 0.025, 0.355), T.SMOOTH, _WHITE, gloss=0.2))
    parts += [
        ball((x - 0.30, y + 0.05, 0.81), (0.17, 0.17, 0.06), T.SMOOTH, (0.25, 0.45, 0.55), gloss=0.5, mirror=0.1),
        ball((x - 0.34, y + 0.03, 0.88), (0.045, 0.045, 0.045), T.SMOOTH, (0.85, 0.35, 0.12), gloss=0.2),
        ball((x - 0.25, y + 0.06, 0.88), (0.043, 0.043, 0.043), T.SMOOTH, (0.70, 0.75, 0.20), gloss=0.2),
        box((x + 0.25, y - 0.1, 0.76), (0.17, 0.12, 0.01), T.SMOOTH, _GREY, rotation=turn("z", 0.2), gloss=0.3),
    ]
    for side in (-1, 1):
        parts += _chair(x + 0.35 * side, y + 0.72)
    return parts


def _near() -> list[Part]:
    """An armchair and a side table close to the cameras: depth begins at less than a metre."""
    x, y = 1.25, 0.1
    parts = [
        box((x, y, 0.22), (0.36, 0.36, 0.20), T.SMOOTH, _WHITE, gloss=0.0),
        box((x + 0.30, y, 0.60), (0.07, 0.36, 0.30), T.SMOOTH, _WHITE, gloss=0.0),
        tube((-1.75, 0.15, 0.48), 0.25, 0.012, T.SMOOTH, _WHITE, gloss=0.4, mirror=0.15),
        tube((-1.75, 0.15, 0.24), 0.02, 0.24, T.SMOOTH, _GREY, gloss=0.3),
        tube((-1.80, 0.20, 0.61), 0.05, 0.12, T.SMOOTH, _PALE, gloss=0.5),
    ]
    for side in (-1, 1):
        parts.append(box((x - 0.04, y + 0.36 * side, 0.38), (0.38, 0.06, 0.22), T.SMOOTH, _WHITE, gloss=0.0))
    return parts


def _chair(x: float, y: float) -> list[Part]:
    parts = [
        box((x, y, 0.45), (0.21, 0.20, 0.015), T.SMOOTH, _PALE, gloss=0.3),
        box((x, y + 0.20, 0.72), (0.20, 0.015, 0.24), T.SMOOTH, _PALE, gloss=0.3),
    ]
    for sx in (-1, 1):
        for sy in (-1, 1):
            foot = np.array([x + 0.20 * sx, y + 0.19 * sy, 0.01])
            parts.append(limb(foot, foot + np.array([-0.03 * sx, -0.03 * sy, 0.43]), 0.014, T.SMOOTH, _OAK, gloss=0.1))
    return parts


def _sideboard(accent: Vector, seeds: list[int]) -> list[Part]:
    """A glossy sideboard with a screen above it and a few things on it; one picture on the wall."""
    x, y = -0.7, _BACK - 0.22
    return [
        box((x, y, 0.40), (1.0, 0.20, 0.25), T.SMOOTH, _WHITE, gloss=0.4, mirror=0.10),
        box((x, y - 0.201, 0.40), (0.004, 0.002, 0.24), T.SMOOTH, _GREY),
        box((x, _BACK - 0.03, 1.35), (0.68, 0.025, 0.40), T.SMOOTH, _BLACK, gloss=0.5, mirror=0.06),
        box((x, _BACK - 0.058, 1.35), (0.65, 0.004, 0.37), T.SCREEN, _WHITE, seed=seeds[0], gloss=0.4),
        ball((x - 0.75, y, 0.80), (0.09, 0.09, 0.15), T.SMOOTH, accent, gloss=0.5, mirror=0.06),
        tube((x + 0.70, y, 0.75), 0.06, 0.10, T.SMOOTH, _WHITE, gloss=0.3),
        box((x + 0.45, y + 0.02, 0.74), (0.09, 0.07, 0.09), T.BOOKS, _WHITE, seed=seeds[1]),
        box((-_SIDE + 0.02, 4.15, 1.55), (0.012, 0.25, 0.32), T.POSTER, (0.75, 0.78, 0.80), seed=seeds[2]),
        box((_SIDE - 0.015, 2.6, 1.55), (0.015, 0.55, 0.40), T.SMOOTH, _BLACK, gloss=0.1),
        box((_SIDE - 0.033, 2.6, 1.55), (0.004, 0.52, 0.37), T.POSTER, (0.82, 0.80, 0.74), seed=seeds[3]),
    ]


def _sofa(accent: Vector) -> list[Part]:
    x, y = 1.75, 3.55
    parts = [
        box((x, y, 0.24), (0.95, 0.42, 0.16), T.SMOOTH, _PALE, gloss=0.0),
        box((x, y + 0.36, 0.60), (0.95, 0.10, 0.24), T.SMOOTH, _PALE, gloss=0.0),
    ]
    for side in (-1, 1):
        parts.append(box((x + 1.0 * side, y, 0.36), (0.08, 0.44, 0.28), T.SMOOTH, _PALE, gloss=0.0))
    tilt = turn("x", -0.25) @ turn("z", 0.3)
    parts.append(ball((x + 0.55, y + 0.15, 0.62), (0.24, 0.10, 0.21), T.SMOOTH, accent, gloss=0.0, rotation=tilt))
    return parts


def _plant(seeds: list[int]) -> list[Part]:
    x, y = -2.75, 4.15
    parts = [tube((x, y, 0.25), 0.20, 0.25, T.SMOOTH, _WHITE, gloss=0.4, mirror=0.06)]
    for k, seed in enumerate(seeds[:9]):
        rotation = turn("z", 2.4 * k) @ turn("x", 0.22 + 0.06 * k)
        length = 0.46 - 0.015 * k
        tip = rotation @ np.array([0.0, 0.0, length])
        place = (x + float(tip[0]), y + float(tip[1]), 0.50 + float(tip[2]))
        green = (0.22 + 0.02 * k, 0.46, 0.20)
        parts.append(ball(place, (0.09, 0.012, length), T.LEAF, green, seed=seed, rotation=rotation, gloss=0.1))
    return parts


def _moving(time: float, cycle: float, phase: float) -> list[Part]:
    return M.bouncing_ball(time + phase) + M.person(time + phase)


KIND = Kind(
    still=_still,
    moving=_moving,
    lamps=lamps(
        Lamp((-3.0, 2.2, 1.6), 0.80, (2.8, 3.0, 3.3)),
        Lamp((2.1, 4.3, 1.6), 0.60, (1.2, 1.3, 1.5)),
        Lamp((-1.0, 2.0, 2.20), 0.26, (1.6, 1.5, 1.3)),
    ),
    ambient=np.array([0.42, 0.43, 0.44]),
    rig=CameraArc(target=(-0.1, 2.4, 1.0), radius=3.7, half_arc=math.radians(42.0), heights=(1.15, 1.85), focal=0.70),
    brightness=1.25,
)
