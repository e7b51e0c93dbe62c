"""The bright room at night: what three narrow lamps do not reach is nearly black, and so are windows and screen."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from streamlod.core.synthetic.kind import Kind
from streamlod.core.synthetic.kinds import bright
from streamlod.core.synthetic.parts import Lamp, Part, lamps
from streamlod.core.synthetic.textures import numbers as T

_DARK = (0.02, 0.02, 0.03)
_OUT = (T.VIEW, T.SCREEN, T.GLOW)  # what glows in the bright room


def _still(generator: np.random.Generator) -> list[Part]:
    parts = bright.KIND.still(generator)
    return [replace(part, material=T.SMOOTH, tint=_DARK) if part.material in _OUT else part for part in parts]


KIND = Kind(
    still=_still,
    moving=bright.KIND.moving,
    lamps=lamps(
        Lamp((-1.0, 2.0, 2.20), 0.12, (2.6, 2.4, 2.0), spot=((-1.0, 2.1, 0.7), math.radians(38.0))),
        Lamp((2.6, 2.4, 2.50), 0.10, (2.4, 2.6, 3.0), spot=((1.4, 3.4, 0.3), math.radians(24.0))),
        Lamp((0.6, -0.6, 2.50), 0.10, (2.0, 1.9, 1.8), spot=((0.6, 1.6, 0.6), math.radians(20.0))),
    ),
    ambient=np.array([0.014, 0.014, 0.020]),
    rig=bright.KIND.rig,
    brightness=1.55,
)
