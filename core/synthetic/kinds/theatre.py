"""A dark stage: curtains with real folds, a glossy piano, a performer and a drum in two spot lights."""

from __future__ import annotations

import math

import numpy as np

from streamlod.core.synthetic import movers as M
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.parts import Lamp, Part, ball, box, lamps, limb, shifted, tube, turn
from streamlod.core.synthetic.shapes import ROOM
from streamlod.core.synthetic.textures import numbers as T

_HALF, _MIDDLE = (4.6, 5.4, 2.3), (0.0, 1.2, 2.3)
_CURTAIN, _BLACK, _BRASS = (0.46, 0.06, 0.08), (0.03, 0.03, 0.035), (0.80, 0.62, 0.26)
_BACK = 5.2  # of the stage, metres


def _still(generator: np.random.Generator) -> list[Part]:
    seeds = generator.integers(0, 1 << 20, 80).tolist()
    parts = [
        Part(ROOM, _HALF, np.array(_MIDDLE), T.SMOOTH, (0.10, 0.10, 0.11), gloss=0.0),
        box((0, 2.9, -0.16), (4.0, 2.8, 0.16), T.WOOD, (0.40, 0.28, 0.19), seed=seeds[0], gloss=0.15, mirror=0.04),
    ]
    width = 0.27 + float(generator.uniform(-0.02, 0.02))
    for k in range(27):  # folds of the curtain behind
        fold = (-3.5 + width * k, _BACK + 0.08 * math.sin(1.9 * k), 1.7)
        parts.append(tube(fold, 0.17 + 0.03 * math.sin(5.1 * k), 1.7, T.PLAIN, _CURTAIN, seed=seeds[1 + k], gloss=0.0))
    for side in (-1, 1):  # and of those at the sides
        for k in range(5):
            fold = (side * (3.3 + 0.05 * math.sin(2.0 * k)), 1.8 + 0.5 * k, 1.7)
            parts.append(tube(fold, 0.22, 1.7, T.PLAIN, (0.10, 0.07, 0.12), seed=seeds[30 + k], gloss=0.0))
    parts += _piano() + _steps(seeds[40:43])
    parts.append(tube((1.75, 3.15, 0.30), 0.16, 0.30, T.WOOD, (0.30, 0.18, 0.12), seed=seeds[44], gloss=0.1))
    for x in (-2.2, 0.6, 2.6):  # lamps at the front edge, which are lit but light nothing
        parts.append(ball((x, 0.5, 0.05), (0.06, 0.06, 0.05), T.GLOW, (0.9, 0.75, 0.45), seed=seeds[45]))
    return parts


def _piano() -> list[Part]:
    x, y = -1.55, 3.3
    polish = {"gloss": 0.6, "mirror": 0.16}
    parts = [
        box((x, y, 0.80), (0.75, 0.55, 0.16), T.SMOOTH, _BLACK, **polish),
        box((x - 0.1, y + 0.1, 1.30), (0.62, 0.012, 0.42), T.SMOOTH, _BLACK, rotation=turn("x", -0.5), **polish),
        box((x, y - 0.62, 0.74), (0.72, 0.09, 0.012), T.BOOKS, (0.95, 0.95, 0.92), gloss=0.3),
        box((x + 0.1, y - 1.15, 0.42), (0.36, 0.17, 0.04), T.SMOOTH, (0.08, 0.07, 0.07), gloss=0.2),
    ]
    for dx, dy in ((-0.65, -0.4), (0.65, -0.4), (0.0, 0.45)):
        parts.append(tube((x + dx, y + dy, 0.32), 0.045, 0.32, T.SMOOTH, _BLACK, **polish))
    for dx, dy in ((-0.28, -0.1), (0.28, -0.1), (-0.28, 0.1), (0.28, 0.1)):
        parts.append(tube((x + 0.1 + dx, y - 1.15 + dy, 0.19), 0.02, 0.19, T.SMOOTH, _BRASS, gloss=0.4))
    return parts


def _steps(seeds: list[int]) -> list[Part]:
    """Painted crates, and a stand with a sheet of music."""
    red, blue, sheet = (0.62, 0.18, 0.16), (0.16, 0.30, 0.52), (0.92, 0.90, 0.84)
    foot, head = np.array([-0.35, 1.92, 0.0]), np.array([-0.3499, 1.92, 1.10])
    return [
        box((2.55, 3.6, 0.22), (0.30, 0.26, 0.22), T.CHECKER, red, seed=seeds[0], rotation=turn("z", 0.4)),
        box((2.50, 3.7, 0.62), (0.22, 0.20, 0.18), T.CHECKER, blue, seed=seeds[1], rotation=turn("z", -0.2)),
        box((-0.35, 1.9, 1.12), (0.20, 0.006, 0.14), T.POSTER, sheet, seed=seeds[2], rotation=turn("x", -0.4)),
        limb(foot, head, 0.012, T.SMOOTH, _BRASS, gloss=0.4),
    ]


def _moving(time: float, cycle: float, phase: float) -> list[Part]:
    drum = shifted([M.globe(time)], (0.0, 0.0, -0.05))
    return M.bouncing_ball(time + phase) + M.person(time + phase) + drum


KIND = Kind(
    still=_still,
    moving=_moving,
    lamps=lamps(
        Lamp((0.9, -1.8, 4.2), 0.06, (34.0, 32.0, 28.0), spot=((0.75, 2.4, 0.8), math.radians(15.0))),
        Lamp((-3.6, -0.8, 4.0), 0.08, (14.0, 16.0, 24.0), spot=((-1.3, 3.0, 0.7), math.radians(15.0))),
        Lamp((0.0, 1.0, 4.4), 0.30, (0.9, 0.8, 0.9)),
    ),
    ambient=np.array([0.018, 0.018, 0.024]),
    rig=CameraArc(target=(0.0, 2.9, 1.0), radius=4.6, half_arc=math.radians(38.0), heights=(1.2, 2.1), focal=0.75),
)
