"""Textures of people, animals and house plants."""

from __future__ import annotations

import math

import numba

from streamlod.core.synthetic.noise import Colour, fbm, line, mix, scale, step

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def face(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    """A head that looks along -y: hair, eyes, brows, nose shadow, mouth."""
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    a, b, f = x / radius, z / radius, f / radius
    skin = scale(tint, 1.0 + 0.07 * fbm(8.0 * a, 8.0 * b, 8.0 * f, seed))
    strands = 1.0 + 0.5 * fbm(40.0 * a + 3.0 * b, 5.0 * b + 5.0 * y / radius, 40.0 * f, seed + 1)
    hair = scale((0.24, 0.13, 0.06), strands)
    if y > 0.25 * radius:
        return hair
    fringe = 0.42 + 0.10 * a + 0.05 * fbm(14.0 * a, 0.0, 14.0 * f, seed + 2) - 0.9 * max(abs(a) - 0.62, 0.0) * 3.0
    for side in (-1.0, 1.0):
        ex, ez = a - 0.30 * side, b - 0.08
        away = math.sqrt(ex * ex + 2.2 * ez * ez)
        skin = mix(skin, (0.96, 0.96, 0.94), 1.0 - step(0.14, away, f))
        skin = mix(skin, (0.12, 0.30, 0.40), 1.0 - step(0.085, away, f))
        skin = mix(skin, (0.03, 0.03, 0.04), 1.0 - step(0.045, away, f))
        brow = b - 0.27 + 0.5 * (ex * ex)
        skin = mix(skin, (0.22, 0.12, 0.06), line(brow, 0.028, f) * (1.0 - step(0.17, abs(ex), f)))
        cheek = math.sqrt((a - 0.42 * side) ** 2 + (b + 0.25) ** 2)
        skin = mix(skin, (0.86, 0.42, 0.36), 0.35 * (1.0 - step(0.14, cheek, 0.2)))
    skin = scale(skin, 1.0 - 0.25 * line(a - 0.03, 0.05, 0.08) * line(b + 0.12, 0.08, 0.1))
    smile = b + 0.40 - 0.9 * a * a
    skin = mix(skin, (0.62, 0.16, 0.16), line(smile, 0.045, f) * (1.0 - step(0.27, abs(a), f)))
    return mix(skin, hair, step(fringe, b, f))


@_jit
def shirt(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    """Cloth with stripes around a body."""
    around = math.atan2(y, x)
    thread = (
        1.0
        + 0.16 * fbm(around * 14.0, z * 90.0, f * 90.0, seed)
        + 0.14 * fbm(around * 2.0, z * 12.0, f * 12.0, seed + 1)
    )
    stripe = z / 0.085 - math.floor(z / 0.085)
    colour = mix(tint, (0.93, 0.91, 0.86), line(stripe - 0.5, 0.16, f / 0.085))
    colour = mix(colour, (0.95, 0.78, 0.20), line(stripe - 0.5, 0.04, f / 0.085))
    return scale(colour, thread)


@_jit
def fur(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    """Fur with dark stripes."""
    wobble = fbm(9.0 * x + 5.0, 9.0 * z + 9.0 * y, 9.0 * f, seed)
    stripe = 0.5 + 0.5 * math.sin(75.0 * z + 14.0 * abs(x) + 3.5 * wobble)
    hair = 1.0 + 0.30 * fbm(160.0 * x, 60.0 * z, 160.0 * f, seed + 1)
    return scale(mix(tint, (0.25, 0.13, 0.06), 0.7 * step(0.55, stripe, 0.3)), hair)


@_jit
def leaf(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A leaf with veins."""
    vein = line((abs(u) * 0.8 + v) / 0.05 - math.floor((abs(u) * 0.8 + v) / 0.05) - 0.5, 0.08, f / 0.05)
    mid = line(u, 0.006, f)
    return mix(
        scale(tint, 1.0 + 0.3 * fbm(u * 25.0, v * 25.0, f * 25.0, seed)), (0.62, 0.78, 0.40), 0.45 * vein + 0.5 * mid
    )
