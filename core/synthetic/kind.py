"""A kind of synthetic place: still and moving parts, light, cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.synthetic.parts import Part, Vector
from streamlod.core.synthetic.shapes import Lamps


@dataclass(frozen=True, slots=True)
class CameraArc:
    """Cameras on a horizontal arc that all look at one point.

    Attributes:
        target: what they look at, metres.
        radius: of the arc round the target, metres; half_arc: angle from its middle to its ends, radians.
        heights: of the two rows of cameras above z = 0, metres.
        focal: focal length as a share of the picture's width.
    """

    target: Vector
    radius: float
    half_arc: float
    heights: tuple[float, float]
    focal: float


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """A place that can be filmed. World axes: x right, y away from the cameras, z up, metres.

    Attributes:
        still: everything that never moves; the first part must enclose the whole scene (a ROOM or the SKY). The
            generator varies tints and texture seeds.
        moving: the parts that move at a time in seconds, always as many and in the same order; its other arguments are
            the clip's cycle in seconds, for things that come and go once, and a shift of the rhythms in [0, 1].
        lamps: what lights the place. ambient: [3] light from everywhere.
        rig: the cameras.
        brightness: of the film curve 1 - exp(-x), before the cameras' own exposures.
        metres_per_second: speed of the fastest thing that moves, as it is at time 0.
    """

    still: Callable[[np.random.Generator], list[Part]]
    moving: Callable[[float, float, float], list[Part]]
    lamps: Lamps
    ambient: Float64
    rig: CameraArc
    brightness: float = 1.55
    metres_per_second: float = 1.0
