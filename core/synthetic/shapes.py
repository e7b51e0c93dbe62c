"""The analytic shapes of the synthetic scene as the compiled code of `casting` and `lighting` sees them."""

from __future__ import annotations

from typing import NamedTuple

import numba

from streamlod.core.arrays import Bool, Float64, Int32

ROOM, BOX, ELLIPSOID, CAPSULE, CYLINDER, SKY = 0, 1, 2, 3, 4, 5
PACKET = 128  # neighbouring rays that share one list of candidate parts
FAR = 1e9
SKY_DISTANCE = 1e8  # metres: no camera of a rig sees it shift


class SolidParts(NamedTuple):
    """P rigid parts of the scene at one instant.

    Attributes:
        kind: [P] int32; size: [P,3] metres: half extents (ROOM, BOX), radii (ELLIPSOID), or radius and half
            length; the SKY has no size.
        rotation: [P,3,3], translation: [P,3] part to world, metres.
        bound: [P] radius of a sphere round the part's origin that encloses it; infinite for the ROOM and the SKY.
        casts: [P] bool, whether the part throws shadows.
        gloss: [P] strength of its highlights.
    """

    kind: Int32
    size: Float64
    rotation: Float64
    translation: Float64
    bound: Float64
    casts: Bool
    gloss: Float64


class Lamps(NamedTuple):
    """K lamps.

    Attributes:
        position: [K,3] metres; radius: [K] metres, a larger lamp throws softer shadows; colour: [K,3] radiant.
        axis: [K,3] unit vectors along which spot lights shine.
        cosine: [K] of half the angle of a spot light's cone; -2 for a lamp that shines in all directions.
    """

    position: Float64
    radius: Float64
    colour: Float64
    axis: Float64
    cosine: Float64


_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def to_local(parts: SolidParts, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A world direction in the axes of part `i`."""
    rotation = parts.rotation[i]
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@_jit
def slab(o: float, d: float, half: float) -> tuple[float, float]:
    """Distances at which a ray enters and leaves |coordinate| <= half."""
    if abs(d) < 1e-12:
        return (-FAR, FAR) if abs(o) <= half else (FAR, -FAR)
    a, b = (-half - o) / d, (half - o) / d
    return (a, b) if a < b else (b, a)
