"""Everything that is hard to follow, in one room: things that roll and spin, turn, wave, cross, enter, open.

At time 0 the fastest of them, the ball, moves at a metre a second: `SyntheticSpec.speed` says how many pixels a frame
that is.
"""

from __future__ import annotations

import math

import numpy as np

from streamlod.core.synthetic import movers as M
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.parts import Lamp, Part, ball, box, lamps, shifted, tube, turn, turned
from streamlod.core.synthetic.shapes import ROOM
from streamlod.core.synthetic.textures import numbers as T

_HALF, _MIDDLE = (4.2, 3.45, 1.45), (0.0, 0.85, 1.45)
_BACK = _MIDDLE[1] + _HALF[1]
_OAK, _WHITE = (0.72, 0.52, 0.32), (0.90, 0.89, 0.85)
_STRIPS, _ROWS = 12, 4  # of the cloth
_PERSON = (0.78, 2.35, 0.0)  # where `movers.person` stands
_CUPBOARD = (0.95, _BACK - 0.22)


def _still(generator: np.random.Generator) -> list[Part]:
    seeds = generator.integers(0, 1 << 20, 20).tolist()
    parts = [
        Part(ROOM, _HALF, np.array(_MIDDLE), T.WALLS, _WHITE, seed=seeds[0]),
        box((0, 2.05, 0.006), (1.25, 0.95, 0.006), T.RUG, (0.20, 0.30, 0.50), seed=seeds[1], gloss=0.0),
        box((-0.6, _BACK - 0.02, 1.7), (0.55, 0.012, 0.38), T.POSTER, (0.75, 0.6, 0.45), seed=seeds[2]),
        box((2.6, _BACK - 0.02, 1.6), (0.40, 0.012, 0.50), T.POSTER, (0.45, 0.6, 0.7), seed=seeds[3]),
        tube((-2.1, 3.55, 2.20), 0.015, 0.75, T.WOOD, _OAK, rotation=turn("y", math.pi / 2), seed=seeds[4]),
        ball((0.0, 1.35, 2.60), (0.13, 0.13, 0.13), T.GLOW, (1.0, 0.95, 0.85), seed=seeds[5]),
    ]
    x, y = _CUPBOARD  # open to the front, where the door is
    parts.append(box((x, _BACK - 0.03, 0.95), (0.40, 0.012, 0.93), T.WOOD, _OAK, seed=seeds[6]))
    for side in (-1, 1):
        parts.append(box((x + 0.40 * side, y, 0.95), (0.018, 0.20, 0.95), T.WOOD, _OAK, seed=seeds[7]))
    for k in range(5):
        parts.append(box((x, y, 0.03 + 0.46 * k), (0.40, 0.20, 0.014), T.WOOD, _OAK, seed=seeds[8]))
    for k in range(3):
        parts.append(box((x, y + 0.05, 0.19 + 0.46 * k), (0.36, 0.10, 0.13), T.BOOKS, _WHITE, seed=seeds[9 + k]))
    parts.append(ball((x, y, 1.56), (0.13, 0.13, 0.13), T.GLOBE, _WHITE, seed=seeds[12]))
    return parts


def _moving(time: float, cycle: float, phase: float) -> list[Part]:
    t = time + phase
    return _rolling_ball(t) + _turning_person(t) + _cloth(t) + _crossing(t) + _carried_in(time) + [_door(t)]


def _rolling_ball(time: float) -> list[Part]:
    """Rolls to and fro at a metre a second, and spins about the upright axis as well."""
    radius, x = 0.2, _to_and_fro(time, 1.0, 1.5)
    rotation = turn("y", x / radius) @ turn("x", 0.5)
    spinning = turn("z", 2.0 * time) @ rotation
    place = (x, 1.25, radius + 0.012)
    return [ball(place, (radius,) * 3, T.BEACH_BALL, (1.0, 1.0, 1.0), seed=5, rotation=spinning, gloss=0.2)]


def _turning_person(time: float) -> list[Part]:
    """Turns round once in five seconds, and waves."""
    return shifted(turned(M.person(time), _PERSON, 1.25 * time), (-0.95, 0.1, 0.0))


def _cloth(time: float) -> list[Part]:
    """A patchwork that hangs from a rod; waves run through it, further out the lower."""
    parts, wide, high = [], 0.11, 0.30
    for i in range(_STRIPS):
        for j in range(_ROWS):
            x, z = -2.75 + wide * i, 2.05 - high * j
            swing, at = 0.03 + 0.035 * j, 4.6 * (x + 0.35 * z) - 5.0 * time
            tilt = turn("z", math.atan(4.6 * swing * math.cos(at))) @ turn("x", 0.25 * math.sin(at))
            tint = (0.30 + 0.5 * ((i * 7 + j * 3) % 5) / 4, 0.30 + 0.4 * ((i + 2 * j) % 4) / 3, 0.30 + 0.13 * (i % 4))
            place = (x, 3.55 + swing * math.sin(at), z)
            half = (0.55 * wide, 0.006, 0.53 * high)
            parts.append(box(place, half, T.FABRIC, tint, seed=50 + i + 20 * j, rotation=tilt, gloss=0.0))
    return parts


def _crossing(time: float) -> list[Part]:
    """Two things at the same height that pass one before the other."""
    x = _to_and_fro(time, 0.7, 1.1)
    return [
        ball((0.2 + x, 3.05, 1.95), (0.17,) * 3, T.GLOBE, _WHITE, seed=31, rotation=turn("z", 1.3 * time), gloss=0.15),
        box((0.2 - x, 3.45, 1.95), (0.15,) * 3, T.CHECKER, (0.80, 0.22, 0.18), seed=32, rotation=turn("z", 0.8 * time)),
    ]


def _carried_in(time: float) -> list[Part]:
    """Somebody comes in through the right edge of the pictures with a parcel, and goes again."""
    x = 2.20 - _to_and_fro(time, 0.7, 0.9, start=-1.0)
    parcel = box((0.62, 1.98, 1.10), (0.20, 0.15, 0.16), T.POSTER, (0.85, 0.70, 0.40), seed=61)
    carrier = [*turned(M.person(0.3 * time), _PERSON, -0.6), parcel]
    return shifted(carrier, (x - _PERSON[0], 0.55, 0.0))


def _door(time: float) -> Part:
    """The cupboard's door, hinged on its left."""
    x, y = _CUPBOARD
    angle = -0.9 - _to_and_fro(time, 1.0, 0.9, start=-1.0)
    hinge, rotation = np.array([x - 0.42, y - 0.215, 0.95]), turn("z", angle)
    place = hinge + rotation @ np.array([0.42, 0.0, 0.0])
    at = (float(place[0]), float(place[1]), float(place[2]))
    return box(at, (0.42, 0.012, 0.95), T.WOOD, (0.50, 0.30, 0.20), seed=71, rotation=rotation, gloss=0.05)


def _to_and_fro(time: float, speed: float, reach: float, start: float = -0.5) -> float:
    """A place that moves at `speed` between -`reach` and `reach`, at time 0 upwards from `start` times `reach`."""
    way = (speed * time + (1.0 + start) * reach) % (4.0 * reach)
    return way - reach if way < 2.0 * reach else 3.0 * reach - way


KIND = Kind(
    still=_still,
    moving=_moving,
    lamps=lamps(
        Lamp((0.0, 1.35, 2.60), 0.13, (8.5, 7.6, 6.2)),
        Lamp((-3.6, 0.5, 2.0), 0.40, (1.6, 1.8, 2.1)),
    ),
    ambient=np.array([0.15, 0.155, 0.17]),
    rig=CameraArc(target=(0.0, 2.5, 1.05), radius=4.0, half_arc=math.radians(24.0), heights=(1.2, 1.8), focal=0.78),
)
