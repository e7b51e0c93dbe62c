"""Textures of floors, walls and rugs."""

from __future__ import annotations

import math

import numba

from streamlod.core.arrays import Float64
from streamlod.core.synthetic.noise import Colour, fbm, hue, line, mix, scale, scatter, step
from streamlod.core.synthetic.textures.numbers import BRICK, PLAIN, PLANKS, WALLPAPER

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def wood(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """Wood with its grain along u."""
    ring = fbm(u * 2.0, v * 22.0, f * 22.0, seed) + 0.5 * math.sin(
        30.0 * (v + 0.06 * fbm(u * 1.5, v * 4.0, f * 4.0, seed + 5))
    )
    grain = fbm(u * 14.0, v * 190.0, f * 190.0, seed + 9)
    return scale(tint, 1.0 + 0.16 * ring + 0.12 * grain)


@_jit
def planks(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A floor of boards, laid along v."""
    row = math.floor(u / 0.145)
    across = u / 0.145 - row
    shift = v / 1.15 + scatter(row, 3, seed)
    board = math.floor(shift)
    along = shift - board
    tone = 0.72 + 0.5 * scatter(row, board, seed + 1)
    colour = wood(v, u + 7.3 * scatter(row, board, seed + 2), f, seed + 3, scale(tint, tone))
    seam = max(line(min(across, 1.0 - across) * 0.145, 0.0022, f), line(min(along, 1.0 - along) * 1.15, 0.002, f))
    return scale(colour, 1.0 - 0.65 * seam)


@_jit
def brick(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A wall of bricks in mortar."""
    row = math.floor(v / 0.082)
    shift = u / 0.235 + 0.5 * (row % 2)
    column = math.floor(shift)
    x, y = (shift - column) * 0.235, v - row * 0.082
    inside = min(x, 0.235 - x, y, 0.082 - y) - 0.0055 - 0.002 * fbm(u * 40.0, v * 40.0, f * 40.0, seed + 4)
    tone = 0.70 + 0.55 * scatter(column, row, seed)
    warm = scatter(column, row, seed + 1) - 0.5
    colour = (tint[0] * tone, tint[1] * (tone + 0.12 * warm), tint[2] * (tone + 0.18 * warm))
    colour = scale(colour, 1.0 + 0.30 * fbm(u * 22.0, v * 22.0, f * 22.0, seed + 2))
    mortar = 0.62 + 0.16 * fbm(u * 60.0, v * 60.0, f * 60.0, seed + 3)
    return mix((mortar, mortar * 0.96, mortar * 0.9), colour, step(0.0, inside, f))


@_jit
def wallpaper(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """Paper with rows of flowers."""
    x, y = u / 0.16, v / 0.16
    i, j = math.floor(x), math.floor(y + 0.5 * (math.floor(x) % 2))
    a, b = x - i - 0.5, y + 0.5 * (i % 2) - j - 0.5
    radius, angle = math.sqrt(a * a + b * b), math.atan2(b, a)
    petal = 0.24 + 0.11 * math.cos(6.0 * angle + 6.28 * scatter(i, j, seed))
    colour = scale(
        tint,
        1.0 + 0.10 * fbm(u * 9.0, v * 9.0, f * 9.0, seed + 1) + 0.06 * fbm(u * 70.0, v * 70.0, f * 70.0, seed + 6),
    )
    accent = hue(scatter(i, j, seed + 2))
    colour = mix(colour, mix(colour, accent, 0.55), 1.0 - step(petal, radius, f / 0.16))
    colour = mix(colour, (0.93, 0.88, 0.72), 1.0 - step(0.07, radius, f / 0.16))
    return mix(colour, scale(tint, 0.62), 0.6 * line(a - 0.5, 0.035, f / 0.16))


@_jit
def rug(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A woven rug with a border, of 2.5 x 1.9 m."""
    edge = min(1.25 - abs(u), 0.95 - abs(v))
    weave = 1.0 + 0.20 * fbm(u * 95.0, v * 95.0, f * 95.0, seed) + 0.14 * fbm(u * 6.0, v * 6.0, f * 6.0, seed + 1)
    x, y = u / 0.25, v / 0.25
    i, j = math.floor(x + 0.5), math.floor(y + 0.5)
    diamond = abs(x - i) + abs(y - j)
    colour = mix(tint, hue(0.58 + 0.25 * scatter(abs(i), abs(j), seed + 2)), 1.0 - step(0.40, diamond, f / 0.25))
    colour = mix(colour, (0.90, 0.82, 0.62), 1.0 - step(0.19, diamond, f / 0.25))
    colour = mix(colour, (0.25, 0.06, 0.08), 1.0 - step(0.09, diamond, f / 0.25))
    if edge < 0.26:
        saw = abs((u + v) / 0.12 - math.floor((u + v) / 0.12) - 0.5)
        band = mix((0.16, 0.20, 0.38), (0.86, 0.66, 0.30), step(0.25, saw, f / 0.12))
        colour = mix(colour, band, 1.0 - step(0.24, edge, f))
        colour = mix(colour, (0.88, 0.84, 0.74), line(edge - 0.235, 0.012, f) + line(edge - 0.05, 0.016, f))
    return scale(colour, weave)


@_jit
def wall_of(normal: Float64) -> tuple[Colour, int]:
    """Colour and texture of the room's faces: planks below, brick behind, plaster above, wallpaper at the sides."""
    if normal[2] > 0.5:
        return (0.60, 0.42, 0.27), PLANKS
    if normal[2] < -0.5:
        return (0.90, 0.89, 0.86), PLAIN
    if normal[1] < -0.5:
        return (0.66, 0.40, 0.31), BRICK
    return (0.66, 0.74, 0.70), WALLPAPER


@_jit
def smooth_walls_of(normal: Float64, u: float, v: float, f: float, seed: int) -> Colour:
    """Plain painted walls and ceiling; below, pale boards with hardly any grain."""
    if normal[2] > 0.5:
        return mix(planks(u, v, f, seed, (0.78, 0.70, 0.60)), (0.76, 0.69, 0.60), 0.75)
    if normal[2] < -0.5:
        return 0.93, 0.93, 0.92
    if normal[1] < -0.5:
        return 0.88, 0.87, 0.84
    return 0.86, 0.88, 0.88
