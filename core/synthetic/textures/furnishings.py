"""Textures of what stands and hangs in rooms: posters, books, cloth, screens, lamps and plain things."""

from __future__ import annotations

import math

import numba

from streamlod.core.synthetic.noise import Colour, fbm, hue, line, mix, scale, scatter, step

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def poster(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """Abstract art: a sky of brush strokes, a sun, hills and a few bars; `tint` sets the mood."""
    colour = mix(tint, hue(scatter(1, 1, seed)), min(max(0.5 + 1.6 * v, 0.0), 1.0))
    colour = scale(
        colour, 1.0 + 0.35 * fbm(u * 9.0 + 3.0 * fbm(u * 3.0, v * 3.0, f * 3.0, seed), v * 26.0, f * 26.0, seed + 1)
    )
    for k in range(4):
        x, y, radius = (
            0.5 * (scatter(k, 2, seed) - 0.5),
            0.42 * (scatter(k, 3, seed) - 0.5),
            0.025 + 0.085 * scatter(k, 4, seed),
        )
        away = math.sqrt((u - x) ** 2 + (v - y) ** 2)
        colour = mix(colour, hue(scatter(k, 5, seed)), 0.9 * (1.0 - step(radius, away, f)))
        colour = mix(colour, (0.08, 0.08, 0.10), line(away - radius - 0.02, 0.004, f))
    for k in range(3):
        hill = (
            -0.06
            - 0.06 * k
            + 0.05 * math.sin(9.0 * u + 6.0 * scatter(k, 7, seed))
            + 0.03 * fbm(u * 18.0, float(k), f * 18.0, seed + k)
        )
        shade = scale(hue(scatter(k, 6, seed)), 0.75 - 0.18 * k)
        colour = mix(shade, colour, step(hill, v, f))
    return colour


@_jit
def books(u: float, v: float, f: float, seed: int, _tint: Colour) -> Colour:
    """A row of book spines of two widths, with bands and lettering."""
    i = math.floor(u / 0.083)
    x = u / 0.083 - i
    split = 0.3 + 0.4 * scatter(i, 1, seed)
    left = x < split
    number = 2 * i + (0 if left else 1)
    half = 0.5 * 0.083 * (split if left else 1.0 - split)
    centre = (0.5 * split if left else 0.5 + 0.5 * split) * 0.083
    off = x * 0.083 - centre
    colour = scale(hue(scatter(number, 2, seed)), 0.55 + 0.5 * scatter(number, 3, seed))
    colour = scale(colour, 1.0 + 0.14 * fbm(u * 60.0, v * 60.0, f * 60.0, seed + 7))
    gold = (0.92, 0.80, 0.46) if scatter(number, 4, seed) > 0.4 else (0.93, 0.93, 0.90)
    place = -0.06 + 0.12 * scatter(number, 5, seed)
    colour = mix(colour, gold, line(v - place, 0.006, f) + line(v - place - 0.03, 0.003, f))
    word = step(0.5, scatter(math.floor(v / 0.011), number, seed + 5), 0.2) * line(off, 0.45 * half, f)
    if -0.09 < v - place < -0.015:
        colour = mix(colour, gold, 0.8 * word)
    top = 0.105 + 0.03 * scatter(number, 6, seed)
    colour = mix(colour, (0.05, 0.035, 0.03), step(top, v, f))
    return scale(colour, 1.0 - 0.75 * line(half - abs(off), 0.0035, f))


@_jit
def fabric(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """Cloth with a faint check."""
    thread = 0.24 * fbm(u * 120.0, v * 120.0, f * 120.0, seed) + 0.16 * fbm(u * 12.0, v * 12.0, f * 12.0, seed + 1)
    check = line((u / 0.11 - math.floor(u / 0.11) - 0.5) * 0.11, 0.014, f) + line(
        (v / 0.11 - math.floor(v / 0.11) - 0.5) * 0.11, 0.014, f
    )
    return scale(mix(tint, (0.88, 0.84, 0.76), 0.22 * check), 1.0 + thread)


@_jit
def screen(u: float, v: float, f: float, seed: int) -> Colour:
    """The picture on a screen: a bar above, lines of text, a chart."""
    colour = (0.90, 0.93, 0.97)
    row = math.floor(v / 0.045)
    length = 0.15 + 0.35 * scatter(row, 1, seed)
    text = line(v / 0.045 - row - 0.5, 0.18, f / 0.045) * (1.0 - step(length - 0.55, u, f)) * step(-0.55, u, f)
    colour = mix(colour, (0.25, 0.28, 0.34), 0.8 * text * (1.0 - step(-0.02, u, f)))
    bar = math.floor(u / 0.07)
    height = -0.25 + 0.35 * scatter(bar, 2, seed)
    chart = line(u / 0.07 - bar - 0.5, 0.35, f / 0.07) * (1.0 - step(height, v, f)) * step(0.06, u, f)
    colour = mix(colour, hue(scatter(bar, 3, seed)), chart)
    return mix(colour, (0.12, 0.30, 0.55), step(0.26, v, f))


@_jit
def plain(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A painted surface that is not quite even."""
    return scale(
        tint, 1.0 + 0.10 * fbm(u * 7.0, v * 7.0, f * 7.0, seed) + 0.07 * fbm(u * 80.0, v * 80.0, f * 80.0, seed + 1)
    )


@_jit
def glowing(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """A shade with light behind it."""
    return scale(tint, 1.0 + 0.05 * fbm(u * 60.0, v * 60.0, f * 60.0, seed))
