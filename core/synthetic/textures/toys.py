"""Textures of toys: a beach ball, a globe, blocks."""

from __future__ import annotations

import math

import numba

from streamlod.core.synthetic.noise import Colour, fbm, line, mix, scale, step

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def beach_ball(x: float, y: float, z: float, f: float, seed: int) -> Colour:
    """A ball in six sectors, three of them coloured."""
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    turn, height = math.atan2(y, x) / 6.2832 + 0.5, z / radius
    sector = math.floor(turn * 6.0)
    colour = (0.93, 0.93, 0.90)
    if sector % 2 == 0:
        colour = (0.86, 0.12, 0.10) if sector == 0 else ((0.95, 0.72, 0.08) if sector == 2 else (0.08, 0.36, 0.78))
    soft = f / max(radius * math.sqrt(max(1.0 - height * height, 1e-4)), 1e-4)
    seam = turn * 6.0 - math.floor(turn * 6.0 + 0.5)
    colour = mix(colour, (0.25, 0.25, 0.28), 0.7 * line(seam, 0.03, soft))
    colour = mix(colour, (0.10, 0.55, 0.42), step(0.86, abs(height), f / radius))
    dots = math.sqrt(((turn * 6.0 - sector - 0.5) * 1.0) ** 2 + height * height)
    colour = mix(colour, (0.12, 0.12, 0.16), 0.9 * (1.0 - step(0.16, dots, f / radius)))
    return scale(colour, 1.0 + 0.10 * fbm(turn * 60.0, height * 20.0, f / radius * 20.0, seed))


@_jit
def globe(x: float, y: float, z: float, f: float, seed: int) -> Colour:
    """A globe: seas, land, ice, and a grid."""
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    turn, height = math.atan2(y, x), z / radius
    f = f / radius
    land = fbm(2.2 * x / radius + 3.0, 2.2 * y / radius + 2.6 * height, 2.2 * f, seed) + 0.5 * fbm(
        3.1 * height, 2.0 * x / radius, 3.0 * f, seed + 3
    )
    colour = scale((0.10, 0.36, 0.62), 1.0 + 0.25 * height)
    ground = mix((0.28, 0.52, 0.20), (0.76, 0.62, 0.34), min(max(2.2 * land, 0.0), 1.0))
    colour = mix(colour, ground, step(0.05, land, 2.0 * f))
    colour = mix(colour, (0.95, 0.96, 0.97), step(0.86 + 0.06 * land, abs(height), f))
    grid = max(
        line((turn / 0.5236 - math.floor(turn / 0.5236 + 0.5)) * 0.5236, 0.012, f),
        line(height * 4.0 - math.floor(height * 4.0 + 0.5), 0.03, 4.0 * f),
    )
    return mix(colour, (0.93, 0.90, 0.78), 0.55 * grid)


@_jit
def checker(u: float, v: float, half: float, f: float, seed: int, tint: Colour) -> Colour:
    """A toy block: a frame of its colour, a checker inside."""
    square = (math.floor(u / (0.5 * half)) + math.floor(v / (0.5 * half))) % 2
    inner = mix((0.95, 0.93, 0.86), (0.15, 0.15, 0.20), float(square))
    colour = mix(inner, tint, step(0.78 * half, max(abs(u), abs(v)), f))
    return scale(colour, 1.0 + 0.12 * fbm(u * 60.0, v * 60.0, f * 60.0, seed))
