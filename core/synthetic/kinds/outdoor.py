"""A garden with a path, trees, two houses and hills, two to sixty metres away, under a sky that is infinitely far."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from streamlod.core.synthetic import movers as M
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.parts import Lamp, Part, Vector, ball, box, lamps, shifted, tube, turn
from streamlod.core.synthetic.shapes import SKY
from streamlod.core.synthetic.textures import numbers as T

_TREES = ((-3.4, 8.5, 2.6), (4.6, 11.0, 3.2), (-8.0, 16.0, 4.0), (9.5, 21.0, 4.6), (-14.0, 30.0, 5.5), (3.5, 38.0, 5.0),
          (19.0, 40.0, 6.0), (-5.0, 46.0, 6.0))  # fmt: skip
_SUN = np.array([-420.0, -500.0, 760.0])


def _still(generator: np.random.Generator) -> list[Part]:
    draw = iter(generator.integers(0, 1 << 20, 120).tolist()).__next__
    parts = [
        Part(SKY, (1.0, 1.0, 1.0), np.zeros(3), T.HEAVEN, seed=draw()),
        box((0, 29, -0.5), (45, 31, 0.5), T.GRASS, (0.24, 0.40, 0.14), seed=draw(), gloss=0.0),
        box((1.9, 9.0, 0.004), (0.55, 9.0, 0.004), T.PLAIN, (0.62, 0.58, 0.52), seed=draw(), gloss=0.0),
    ]
    for x, radius, height in ((-34.0, 26.0, 9.0), (4.0, 30.0, 6.5), (40.0, 28.0, 10.5)):
        hill = (0.36, 0.47, 0.34)
        parts.append(ball((x, 62.0, 0.0), (radius, 6.0, height), T.FOLIAGE, hill, seed=draw(), gloss=0.0))
    for x, y, height in _TREES:
        parts += _tree(x, y, height, draw, generator)
    parts += _house((-4.0, 22.0, 0.0), 1.0, T.BRICK, (0.62, 0.38, 0.30), draw)
    parts += _house((10.5, 34.0, 0.0), 1.25, T.SMOOTH, (0.90, 0.88, 0.80), draw)
    for k in range(22):  # a fence
        x = -6.6 + 0.34 * k
        parts.append(box((x, 9.6, 0.5), (0.06, 0.02, 0.5), T.WOOD, (0.62, 0.48, 0.34), seed=draw(), gloss=0.0))
    parts.append(box((-3.0, 9.64, 0.72), (3.7, 0.02, 0.05), T.WOOD, (0.55, 0.42, 0.30), seed=draw(), gloss=0.0))
    parts += _near(draw)
    return parts


def _tree(x: float, y: float, height: float, draw: Callable[[], int], generator: np.random.Generator) -> list[Part]:
    bark, leaf = (0.34, 0.25, 0.18), (0.20 + float(generator.uniform(0, 0.12)), 0.36, 0.12)
    trunk = 0.05 * height
    parts = [tube((x, y, 0.3 * height), trunk, 0.3 * height, T.WOOD, bark, seed=draw(), gloss=0.0)]
    for k in range(5):
        turned, up = 2.4 * k, 0.62 + 0.09 * k
        place = (x + 0.17 * height * math.cos(turned), y + 0.17 * height * math.sin(turned), up * height)
        radii = (0.24 * height, 0.22 * height, 0.18 * height)
        parts.append(ball(place, radii, T.FOLIAGE, leaf, seed=draw(), gloss=0.0))
    return parts


def _house(place: Vector, size: float, walls: int, tint: Vector, draw: Callable[[], int]) -> list[Part]:
    """Walls, a gabled roof of two slabs, a door and four windows on the side that faces the cameras."""
    wide, deep, high = 3.2 * size, 2.6 * size, 1.6 * size
    parts = [box((0, 0, high), (wide, deep, high), walls, tint, seed=draw(), gloss=0.0)]
    for side in (-1, 1):
        slope = turn("x", -0.6 * side)
        middle = (0.0, -0.5 * side * deep, 2.0 * high + 0.30 * deep)
        roof = (wide + 0.3, 0.68 * deep, 0.08)
        parts.append(box(middle, roof, T.BRICK, (0.45, 0.22, 0.18), seed=draw(), rotation=slope, gloss=0.0))
    parts.append(
        box((0, -deep - 0.02, 0.62 * high), (0.5 * size, 0.04, 0.62 * high), T.WOOD, (0.30, 0.36, 0.30), seed=draw())
    )
    for x in (-0.62, 0.62):
        for z in (0.62, 1.45):
            window = (x * wide, -deep - 0.02, z * high)
            parts.append(
                box(window, (0.5 * size, 0.04, 0.28 * high), T.SMOOTH, (0.16, 0.20, 0.26), gloss=0.5, mirror=0.3)
            )
    return shifted(parts, place)


def _near(draw: Callable[[], int]) -> list[Part]:
    """Things close to the cameras: a bench, stones, two bushes, a post with a letter box."""
    parts = [
        box((-1.7, 5.2, 0.46), (0.75, 0.20, 0.025), T.WOOD, (0.58, 0.40, 0.26), seed=draw()),
        box((-1.7, 5.42, 0.76), (0.75, 0.02, 0.16), T.WOOD, (0.58, 0.40, 0.26), seed=draw()),
        box((3.2, 4.6, 0.55), (0.05, 0.05, 0.55), T.WOOD, (0.44, 0.34, 0.26), seed=draw()),
        box((3.2, 4.55, 1.22), (0.16, 0.22, 0.13), T.SMOOTH, (0.62, 0.14, 0.12), gloss=0.3),
        ball((-2.9, 3.7, 0.16), (0.52, 0.44, 0.34), T.FOLIAGE, (0.24, 0.42, 0.14), seed=draw(), gloss=0.0),
        ball((3.7, 6.4, 0.30), (0.70, 0.60, 0.55), T.FOLIAGE, (0.30, 0.38, 0.16), seed=draw(), gloss=0.0),
    ]
    for side in (-1, 1):
        parts.append(box((-1.7 + 0.6 * side, 5.2, 0.22), (0.04, 0.18, 0.22), T.SMOOTH, (0.20, 0.20, 0.21)))
    for x, y, radius in ((0.2, 3.1, 0.16), (0.6, 3.4, 0.10), (2.8, 3.2, 0.20)):
        stone = (1.3 * radius, radius, 0.8 * radius)
        parts.append(ball((x, y, 0.3 * radius), stone, T.PLAIN, (0.55, 0.54, 0.52), seed=draw(), gloss=0.0))
    return parts


def _moving(time: float, cycle: float, phase: float) -> list[Part]:
    return shifted(M.bouncing_ball(time + phase), (0.2, 3.6, 0.0)) + shifted(M.person(time + phase), (1.1, 3.4, 0.0))


KIND = Kind(
    still=_still,
    moving=_moving,
    lamps=lamps(Lamp((float(_SUN[0]), float(_SUN[1]), float(_SUN[2])), 9.0, (2.1e6, 2.0e6, 1.75e6))),
    ambient=np.array([0.30, 0.34, 0.42]),
    rig=CameraArc(target=(0.0, 7.0, 1.5), radius=6.2, half_arc=math.radians(30.0), heights=(1.35, 2.1), focal=0.78),
    brightness=1.15,
)
