"""A living room, 5.8 m wide, full of texture: brick, wallpaper, books, a rug, a mirror."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from streamlod.core.synthetic import movers as M
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.parts import Lamp, Part, ball, box, lamps, limb, tube, turn
from streamlod.core.synthetic.shapes import ROOM
from streamlod.core.synthetic.textures import numbers as T

_HALF = (2.9, 3.45, 1.35)
_MIDDLE = (0.0, 0.85, 1.35)
_BACK = _MIDDLE[1] + _HALF[1]
_OAK, _WALNUT, _WHITE, _STEEL = (0.72, 0.52, 0.32), (0.40, 0.24, 0.15), (0.90, 0.89, 0.85), (0.80, 0.82, 0.85)


def _still(generator: np.random.Generator) -> list[Part]:
    """Everything that never moves; `generator` varies tints, leaves and texture seeds."""
    draw = iter(generator.integers(0, 1 << 20, 200).tolist()).__next__
    parts = [
        Part(ROOM, _HALF, np.array(_MIDDLE), T.WALLS, _WHITE, seed=draw()),
        box((0, 2.05, 0.006), (1.25, 0.95, 0.006), T.RUG, (0.60, 0.16, 0.16), seed=draw(), gloss=0.0),
        box((0, _BACK - 0.012, 0.05), (_HALF[0], 0.012, 0.05), T.PLAIN, _WHITE, seed=draw()),
        box((-_HALF[0] + 0.012, 0.85, 0.05), (0.012, _HALF[1], 0.05), T.PLAIN, _WHITE, seed=draw()),
        box((_HALF[0] - 0.012, 0.85, 0.05), (0.012, _HALF[1], 0.05), T.PLAIN, _WHITE, seed=draw()),
    ]
    hue = generator.uniform(-0.04, 0.04)
    parts += _sofa((0.22 + hue, 0.36, 0.46 - hue), draw)
    parts += _table(draw) + _shelf(draw) + _walls(draw) + _corner(draw, generator) + _toys(draw)
    parts.append(ball((0.35, 1.35, 2.36), (0.13, 0.13, 0.13), T.GLOW, (1.0, 0.95, 0.85), seed=draw()))
    parts.append(limb(np.array([0.35, 1.35, 2.48]), np.array([0.3501, 1.35, 2.70]), 0.012, T.PLAIN, (0.2, 0.2, 0.2)))
    return parts


def _sofa(tint: tuple[float, float, float], draw: Callable[[], int]) -> list[Part]:
    x, y = -0.35, 3.35
    parts = [
        box((x, y, 0.22), (1.0, 0.42, 0.17), T.FABRIC, tint, seed=draw()),
        box((x, y + 0.36, 0.58), (1.0, 0.11, 0.26), T.FABRIC, tint, seed=draw()),
    ]
    for side in (-1, 1):
        parts.append(box((x + side * 1.06, y, 0.33), (0.10, 0.44, 0.29), T.FABRIC, tint, seed=draw()))
        tilt = turn("x", -0.25) @ turn("z", 0.2 * side)
        colour = (0.86, 0.58, 0.16) if side < 0 else (0.74, 0.24, 0.20)
        place = (x + side * 0.62, y + 0.12, 0.60)
        parts.append(ball(place, (0.26, 0.11, 0.22), T.FABRIC, colour, seed=draw(), rotation=tilt))
    return parts


def _table(draw: Callable[[], int]) -> list[Part]:
    x, y = -1.15, 2.05
    parts = [tube((x, y, 0.44), 0.50, 0.02, T.WOOD, _WALNUT, seed=draw(), gloss=0.10, mirror=0.10)]
    for k in range(3):
        a = 2.1 * k + 0.4
        foot = np.array([x + 0.40 * math.cos(a), y + 0.40 * math.sin(a), 0.02])
        head = np.array([x + 0.26 * math.cos(a), y + 0.26 * math.sin(a), 0.42])
        parts.append(limb(foot, head, 0.022, T.WOOD, _WALNUT, seed=draw()))
    parts += [
        ball((x + 0.10, y + 0.05, 0.63), (0.17, 0.17, 0.17), T.PLAIN, _STEEL, gloss=0.6, mirror=0.82),
        tube((x - 0.24, y - 0.14, 0.515), 0.045, 0.055, T.SHIRT, (0.20, 0.42, 0.62), seed=draw(), gloss=0.25),
        box((x - 0.20, y + 0.20, 0.475), (0.13, 0.09, 0.015), T.POSTER, (0.85, 0.75, 0.5), seed=draw(),
            rotation=turn("z", 0.35)),
        box((x - 0.19, y + 0.20, 0.502), (0.11, 0.08, 0.012), T.POSTER, (0.35, 0.55, 0.6), seed=draw(),
            rotation=turn("z", -0.15)),
    ]  # fmt: skip
    return parts


def _shelf(draw: Callable[[], int]) -> list[Part]:
    x, y, half = -2.25, _BACK - 0.17, 0.52
    parts = [box((x, _BACK - 0.02, 0.98), (half, 0.012, 0.95), T.WOOD, _WALNUT, seed=draw())]
    for side in (-1, 1):
        parts.append(box((x + side * half, y, 0.98), (0.018, 0.15, 0.98), T.WOOD, _OAK, seed=draw()))
    for k in range(6):
        parts.append(box((x, y, 0.03 + 0.382 * k), (half, 0.15, 0.014), T.WOOD, _OAK, seed=draw()))
    for k, (left, right) in enumerate(((-0.5, 0.5), (-0.5, 0.12), (-0.15, 0.5), (-0.5, 0.3), (-0.1, 0.5))):
        place, width = (x + (left + right) / 2, y + 0.02, 0.175 + 0.382 * k), (right - left) / 2
        parts.append(box(place, (width, 0.10, 0.128), T.BOOKS, _WHITE, seed=draw()))
    parts += [
        ball((x + 0.32, y - 0.02, 0.585), (0.10, 0.10, 0.155), T.PLAIN, (0.25, 0.5, 0.52), seed=draw(), gloss=0.35),
        ball((x - 0.33, y - 0.02, 0.90), (0.09, 0.09, 0.09), T.CHECKER, (0.8, 0.5, 0.2), seed=draw()),
        tube((x + 0.40, y - 0.01, 1.285), 0.05, 0.09, T.SHIRT, (0.7, 0.35, 0.2), seed=draw()),
        box((x - 0.32, y - 0.02, 1.68), (0.10, 0.02, 0.11), T.POSTER, (0.8, 0.6, 0.5), seed=draw()),
    ]
    return parts


def _walls(draw: Callable[[], int]) -> list[Part]:
    parts = []
    moods = ((0.85, 0.70, 0.45), (0.40, 0.62, 0.72), (0.75, 0.55, 0.60))
    for (x, z, w, h), mood in zip(
        ((-0.95, 1.62, 0.34, 0.25), (0.02, 1.74, 0.42, 0.32), (0.92, 1.60, 0.27, 0.34)), moods, strict=True
    ):
        parts.append(box((x, _BACK - 0.014, z), (w + 0.03, 0.014, h + 0.03), T.WOOD, _WALNUT, seed=draw()))
        parts.append(box((x, _BACK - 0.030, z), (w, 0.004, h), T.POSTER, mood, seed=draw(), gloss=0.06))
    window, mirror = -_HALF[0], _HALF[0]
    parts.append(box((window + 0.01, 1.95, 1.55), (0.01, 0.80, 0.62), T.VIEW, _WHITE, seed=draw()))
    for y in (1.13, 1.95, 2.77):
        parts.append(box((window + 0.03, y, 1.55), (0.03, 0.03, 0.66), T.PLAIN, _WHITE, seed=draw()))
    for z in (0.91, 1.55, 2.19):
        parts.append(box((window + 0.03, 1.95, z), (0.03, 0.84, 0.03), T.PLAIN, _WHITE, seed=draw()))
    parts.append(box((mirror - 0.015, 2.75, 1.40), (0.015, 0.56, 0.76), T.WOOD, _OAK, seed=draw()))
    parts.append(box((mirror - 0.034, 2.75, 1.40), (0.004, 0.50, 0.70), T.PLAIN, _STEEL, gloss=0.3, mirror=0.86))
    return parts


def _corner(draw: Callable[[], int], generator: np.random.Generator) -> list[Part]:
    """Side table, floor lamp and plant on the right."""
    parts = [box((1.75, 3.15, 0.55), (0.27, 0.27, 0.018), T.WOOD, _OAK, seed=draw(), gloss=0.05)]
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        place = (1.75 + 0.23 * sx, 3.15 + 0.23 * sy, 0.266)
        parts.append(box(place, (0.02, 0.02, 0.266), T.WOOD, _OAK, seed=draw()))
    parts += [
        tube((1.75, 3.15, 0.578), 0.10, 0.012, T.PLAIN, _STEEL, gloss=0.4),
        tube((1.75, 3.15, 0.62), 0.014, 0.04, T.PLAIN, _STEEL, gloss=0.4),
        tube((1.22, 3.95, 0.015), 0.16, 0.015, T.PLAIN, (0.15, 0.15, 0.16), gloss=0.2),
        tube((1.22, 3.95, 0.70), 0.013, 0.70, T.PLAIN, (0.15, 0.15, 0.16), gloss=0.2),
        tube((1.22, 3.95, 1.46), 0.20, 0.14, T.GLOW, (0.86, 0.72, 0.50), seed=draw()),
        tube((2.35, 3.70, 0.17), 0.20, 0.17, T.SHIRT, (0.70, 0.42, 0.30), seed=draw()),
        tube((2.35, 3.70, 0.335), 0.18, 0.01, T.PLAIN, (0.20, 0.14, 0.10), seed=draw()),
    ]
    for k in range(11):
        lean, spin = 0.28 + 0.07 * k, 2.4 * k + generator.uniform(-0.2, 0.2)
        length = 0.42 - 0.016 * k
        rotation = turn("z", spin) @ turn("x", lean)
        tip = rotation @ np.array([0.0, 0.0, length])
        place = (2.35 + float(tip[0]), 3.70 + float(tip[1]), 0.36 + float(tip[2]) + 0.015 * (11 - k))
        green = (0.20 + 0.015 * k, 0.44 + 0.012 * k, 0.18)
        parts.append(ball(place, (0.085, 0.012, length), T.LEAF, green, seed=draw(), rotation=rotation, gloss=0.08))
    return parts


def _toys(draw: Callable[[], int]) -> list[Part]:
    blocks = (
        (1.62, 1.62, 0.13, 0.13, 0.3, (0.80, 0.22, 0.18)),
        (1.93, 1.80, 0.13, 0.13, -0.2, (0.16, 0.44, 0.72)),
        (1.76, 1.70, 0.36, 0.10, 0.75, (0.92, 0.70, 0.16)),
    )
    parts = []
    for x, y, z, half, spin, tint in blocks:
        parts.append(box((x, y, z), (half,) * 3, T.CHECKER, tint, seed=draw(), rotation=turn("z", spin), gloss=0.05))
    return parts


def _moving(time: float, cycle: float, phase: float) -> list[Part]:
    return M.bouncing_ball(time + phase) + M.person(time + phase) + M.visitor(time, cycle) + [M.globe(time)]


KIND = Kind(
    still=_still,
    moving=_moving,
    lamps=lamps(
        Lamp((0.35, 1.35, 2.30), 0.11, (7.0, 6.2, 5.0)),
        Lamp((-2.75, 1.75, 1.65), 0.30, (0.85, 1.0, 1.2)),
    ),
    ambient=np.array([0.115, 0.12, 0.14]),
    rig=CameraArc(target=(0.0, 2.5, 0.95), radius=4.0, half_arc=math.radians(19.0), heights=(1.25, 1.75), focal=0.78),
)
