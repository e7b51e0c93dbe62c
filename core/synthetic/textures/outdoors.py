"""Textures of the outdoors: sky, grass and bushes, and the view from a window."""

from __future__ import annotations

import math

import numba

from streamlod.core.synthetic.noise import Colour, fbm, mix, scale, step

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def view(u: float, v: float, f: float, seed: int) -> Colour:
    """The view from the window: sky, clouds, far hills, trees."""
    cloud = min(max(0.3 + 1.6 * fbm(u * 3.0, v * 7.0, f * 7.0, seed), 0.0), 1.0)
    colour = mix(mix((0.80, 0.90, 0.98), (0.38, 0.62, 0.92), min(max(0.4 + v, 0.0), 1.0)), (0.98, 0.98, 0.98), cloud)
    hill = -0.10 + 0.09 * fbm(u * 2.5, 1.0, f * 2.5, seed + 1)
    colour = mix((0.42, 0.56, 0.50), colour, step(hill, v, f))
    tree = -0.26 + 0.16 * fbm(u * 9.0, 2.0, f * 9.0, seed + 2)
    leaves = 1.0 + 0.5 * fbm(u * 30.0, v * 30.0, f * 30.0, seed + 3)
    return mix(scale((0.20, 0.38, 0.16), leaves), colour, step(tree, v, f))


@_jit
def heaven(x: float, y: float, z: float, f: float, seed: int) -> Colour:
    """The sky in a direction: blue, paler towards the horizon, with clouds on a flat ceiling far above."""
    away = math.sqrt(x * x + y * y + z * z)
    height = max(z / away, 0.0) + 0.12
    u, v, f = x / away / height, y / away / height, f / away / (height * height)
    cloud = min(max(0.25 + 1.7 * fbm(u * 1.1, v * 1.1, f * 1.1, seed), 0.0), 1.0)
    colour = mix((0.86, 0.91, 0.96), (0.36, 0.58, 0.90), min(1.6 * (height - 0.12), 1.0))
    return mix(colour, (0.97, 0.97, 0.97), 0.9 * cloud * min(12.0 * (height - 0.12), 1.0))


@_jit
def grass(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A lawn with dry patches."""
    patch = fbm(u * 0.35, v * 0.35, f * 0.35, seed)
    blades = fbm(u * 8.0, v * 8.0, f * 8.0, seed + 1) + 0.6 * fbm(u * 45.0, v * 45.0, f * 45.0, seed + 2)
    return scale(mix(tint, (0.55, 0.52, 0.26), min(max(0.3 + 0.8 * patch, 0.0), 1.0)), 1.0 + 0.35 * blades)


@_jit
def foliage(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    """Leaves in clumps."""
    clumps = fbm(4.0 * x + 3.0 * z, 4.0 * y - 2.0 * z, 4.0 * f, seed)
    leaves = fbm(17.0 * x - 9.0 * z, 17.0 * y + 14.0 * z, 17.0 * f, seed + 1)
    return scale(tint, 0.85 + 0.55 * clumps + 0.5 * leaves)
