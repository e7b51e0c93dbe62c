"""Procedural textures: the colour of a surface point from its place on its part.

Compiled together in this file for the same reason as `geometry`. Detail finer than a pixel's footprint is faded out,
so that what two cameras see of one spot agrees.
"""

from __future__ import annotations

import math

import numba
import numpy as np

PLAIN, WOOD, PLANKS, BRICK, WALLPAPER, RUG, POSTER, BOOKS = 0, 1, 2, 3, 4, 5, 6, 7
FABRIC, BEACH_BALL, GLOBE, FACE, SHIRT, LEAF, GLOW, VIEW, CHECKER, FUR, WALLS = 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def _hash(x, y, seed):
    """A fixed pseudo-random number in [0, 1) for a lattice point."""
    h = np.uint32(np.int64(x) * 374761393 + np.int64(y) * 668265263 + np.int64(seed) * 974634777)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    return np.float64(h ^ (h >> np.uint32(15))) / 4294967296.0


@_jit
def _noise(x, y, seed):
    """Smooth value noise in [0, 1] with unit cells."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    low = _hash(i, j, seed) * (1.0 - u) + _hash(i + 1, j, seed) * u
    high = _hash(i, j + 1, seed) * (1.0 - u) + _hash(i + 1, j + 1, seed) * u
    return low * (1.0 - v) + high * v


@_jit
def _fbm(x, y, footprint, seed):
    """Five octaves of noise round 0 in about [-1, 1]; octaves finer than `footprint` (in cells) fade out."""
    total, strength, scale = 0.0, 0.55, 1.0
    for octave in range(5):
        fade = min(max(1.0 / (scale * max(footprint, 1e-6)) - 1.0, 0.0), 1.0)
        if fade <= 0.0:
            break
        total += fade * strength * (2.0 * _noise(x * scale, y * scale, seed + 31 * octave) - 1.0)
        strength, scale = 0.6 * strength, 2.03 * scale
    return total


@_jit
def _step(edge, x, footprint):
    """0 below `edge`, 1 above, softened over a footprint."""
    t = min(max((x - edge) / max(footprint, 1e-6) + 0.5, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@_jit
def _line(x, half, footprint):
    """1 where |x| < half, softened over a footprint, keeping its area."""
    width = max(half, 0.5 * footprint)
    return (half / width) * (1.0 - _step(width, abs(x), footprint))


@_jit
def _mix(a, b, t):
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@_jit
def _scale(a, t):
    return a[0] * t, a[1] * t, a[2] * t


@_jit
def _hue(h):
    """A bright but not garish colour for a hue in [0, 1]."""
    return (
        0.52 + 0.38 * math.cos(6.2832 * h),
        0.50 + 0.34 * math.cos(6.2832 * (h - 0.36)),
        0.48 + 0.36 * math.cos(6.2832 * (h - 0.67)),
    )


@_jit
def _wood(u, v, f, seed, tint):
    ring = _fbm(u * 2.0, v * 22.0, f * 22.0, seed) + 0.5 * math.sin(
        30.0 * (v + 0.06 * _fbm(u * 1.5, v * 4.0, f * 4.0, seed + 5))
    )
    grain = _fbm(u * 14.0, v * 190.0, f * 190.0, seed + 9)
    return _scale(tint, 1.0 + 0.16 * ring + 0.12 * grain)


@_jit
def _planks(u, v, f, seed, tint):
    row = math.floor(u / 0.145)
    across = u / 0.145 - row
    shift = v / 1.15 + _hash(row, 3, seed)
    board = math.floor(shift)
    along = shift - board
    tone = 0.72 + 0.5 * _hash(row, board, seed + 1)
    colour = _wood(v, u + 7.3 * _hash(row, board, seed + 2), f, seed + 3, _scale(tint, tone))
    seam = max(_line(min(across, 1.0 - across) * 0.145, 0.0022, f), _line(min(along, 1.0 - along) * 1.15, 0.002, f))
    return _scale(colour, 1.0 - 0.65 * seam)


@_jit
def _brick(u, v, f, seed, tint):
    row = math.floor(v / 0.082)
    shift = u / 0.235 + 0.5 * (row % 2)
    column = math.floor(shift)
    x, y = (shift - column) * 0.235, v - row * 0.082
    inside = min(min(x, 0.235 - x), min(y, 0.082 - y)) - 0.0055 - 0.002 * _fbm(u * 40.0, v * 40.0, f * 40.0, seed + 4)
    tone = 0.70 + 0.55 * _hash(column, row, seed)
    warm = _hash(column, row, seed + 1) - 0.5
    colour = (tint[0] * tone, tint[1] * (tone + 0.12 * warm), tint[2] * (tone + 0.18 * warm))
    colour = _scale(colour, 1.0 + 0.30 * _fbm(u * 22.0, v * 22.0, f * 22.0, seed + 2))
    mortar = 0.62 + 0.16 * _fbm(u * 60.0, v * 60.0, f * 60.0, seed + 3)
    return _mix((mortar, mortar * 0.96, mortar * 0.9), colour, _step(0.0, inside, f))


@_jit
def _wallpaper(u, v, f, seed, tint):
    x, y = u / 0.16, v / 0.16
    i, j = math.floor(x), math.floor(y + 0.5 * (math.floor(x) % 2))
    a, b = x - i - 0.5, y + 0.5 * (i % 2) - j - 0.5
    radius, angle = math.sqrt(a * a + b * b), math.atan2(b, a)
    petal = 0.24 + 0.11 * math.cos(6.0 * angle + 6.28 * _hash(i, j, seed))
    colour = _scale(
        tint,
        1.0 + 0.10 * _fbm(u * 9.0, v * 9.0, f * 9.0, seed + 1) + 0.06 * _fbm(u * 70.0, v * 70.0, f * 70.0, seed + 6),
    )
    accent = _hue(_hash(i, j, seed + 2))
    colour = _mix(colour, _mix(colour, accent, 0.55), 1.0 - _step(petal, radius, f / 0.16))
    colour = _mix(colour, (0.93, 0.88, 0.72), 1.0 - _step(0.07, radius, f / 0.16))
    return _mix(colour, _scale(tint, 0.62), 0.6 * _line(a - 0.5, 0.035, f / 0.16))


@_jit
def _rug(u, v, f, seed, tint):
    edge = min(1.25 - abs(u), 0.95 - abs(v))
    weave = 1.0 + 0.20 * _fbm(u * 95.0, v * 95.0, f * 95.0, seed) + 0.14 * _fbm(u * 6.0, v * 6.0, f * 6.0, seed + 1)
    x, y = u / 0.25, v / 0.25
    i, j = math.floor(x + 0.5), math.floor(y + 0.5)
    diamond = abs(x - i) + abs(y - j)
    colour = _mix(tint, _hue(0.58 + 0.25 * _hash(abs(i), abs(j), seed + 2)), 1.0 - _step(0.40, diamond, f / 0.25))
    colour = _mix(colour, (0.90, 0.82, 0.62), 1.0 - _step(0.19, diamond, f / 0.25))
    colour = _mix(colour, (0.25, 0.06, 0.08), 1.0 - _step(0.09, diamond, f / 0.25))
    if edge < 0.26:
        saw = abs((u + v) / 0.12 - math.floor((u + v) / 0.12) - 0.5)
        band = _mix((0.16, 0.20, 0.38), (0.86, 0.66, 0.30), _step(0.25, saw, f / 0.12))
        colour = _mix(colour, band, 1.0 - _step(0.24, edge, f))
        colour = _mix(colour, (0.88, 0.84, 0.74), _line(edge - 0.235, 0.012, f) + _line(edge - 0.05, 0.016, f))
    return _scale(colour, weave)


@_jit
def _poster(u, v, f, seed, tint):
    """Abstract art: a sky of brush strokes, a sun, hills and a few bars; `tint` sets the mood."""
    colour = _mix(tint, _hue(_hash(1, 1, seed)), min(max(0.5 + 1.6 * v, 0.0), 1.0))
    colour = _scale(
        colour, 1.0 + 0.35 * _fbm(u * 9.0 + 3.0 * _fbm(u * 3.0, v * 3.0, f * 3.0, seed), v * 26.0, f * 26.0, seed + 1)
    )
    for k in range(4):
        x, y, radius = (
            0.5 * (_hash(k, 2, seed) - 0.5),
            0.42 * (_hash(k, 3, seed) - 0.5),
            0.025 + 0.085 * _hash(k, 4, seed),
        )
        away = math.sqrt((u - x) ** 2 + (v - y) ** 2)
        colour = _mix(colour, _hue(_hash(k, 5, seed)), 0.9 * (1.0 - _step(radius, away, f)))
        colour = _mix(colour, (0.08, 0.08, 0.10), _line(away - radius - 0.02, 0.004, f))
    for k in range(3):
        hill = (
            -0.06
            - 0.06 * k
            + 0.05 * math.sin(9.0 * u + 6.0 * _hash(k, 7, seed))
            + 0.03 * _fbm(u * 18.0, float(k), f * 18.0, seed + k)
        )
        shade = _scale(_hue(_hash(k, 6, seed)), 0.75 - 0.18 * k)
        colour = _mix(shade, colour, _step(hill, v, f))
    return colour


@_jit
def _books(u, v, f, seed, _tint):
    """A row of book spines of two widths, with bands and lettering."""
    i = math.floor(u / 0.083)
    x = u / 0.083 - i
    split = 0.3 + 0.4 * _hash(i, 1, seed)
    left = x < split
    number = 2 * i + (0 if left else 1)
    half = 0.5 * 0.083 * (split if left else 1.0 - split)
    centre = (0.5 * split if left else 0.5 + 0.5 * split) * 0.083
    off = x * 0.083 - centre
    colour = _scale(_hue(_hash(number, 2, seed)), 0.55 + 0.5 * _hash(number, 3, seed))
    colour = _scale(colour, 1.0 + 0.14 * _fbm(u * 60.0, v * 60.0, f * 60.0, seed + 7))
    gold = (0.92, 0.80, 0.46) if _hash(number, 4, seed) > 0.4 else (0.93, 0.93, 0.90)
    place = -0.06 + 0.12 * _hash(number, 5, seed)
    colour = _mix(colour, gold, _line(v - place, 0.006, f) + _line(v - place - 0.03, 0.003, f))
    word = _step(0.5, _hash(math.floor(v / 0.011), number, seed + 5), 0.2) * _line(off, 0.45 * half, f)
    if -0.09 < v - place < -0.015:
        colour = _mix(colour, gold, 0.8 * word)
    top = 0.105 + 0.03 * _hash(number, 6, seed)
    colour = _mix(colour, (0.05, 0.035, 0.03), _step(top, v, f))
    return _scale(colour, 1.0 - 0.75 * _line(half - abs(off), 0.0035, f))


@_jit
def _fabric(u, v, f, seed, tint):
    thread = 0.24 * _fbm(u * 120.0, v * 120.0, f * 120.0, seed) + 0.16 * _fbm(u * 12.0, v * 12.0, f * 12.0, seed + 1)
    check = _line((u / 0.11 - math.floor(u / 0.11) - 0.5) * 0.11, 0.014, f) + _line(
        (v / 0.11 - math.floor(v / 0.11) - 0.5) * 0.11, 0.014, f
    )
    return _scale(_mix(tint, (0.88, 0.84, 0.76), 0.22 * check), 1.0 + thread)


@_jit
def _beach_ball(x, y, z, f, seed):
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    turn, height = math.atan2(y, x) / 6.2832 + 0.5, z / radius
    sector = math.floor(turn * 6.0)
    colour = (0.93, 0.93, 0.90)
    if sector % 2 == 0:
        colour = (0.86, 0.12, 0.10) if sector == 0 else ((0.95, 0.72, 0.08) if sector == 2 else (0.08, 0.36, 0.78))
    soft = f / max(radius * math.sqrt(max(1.0 - height * height, 1e-4)), 1e-4)
    seam = turn * 6.0 - math.floor(turn * 6.0 + 0.5)
    colour = _mix(colour, (0.25, 0.25, 0.28), 0.7 * _line(seam, 0.03, soft))
    colour = _mix(colour, (0.10, 0.55, 0.42), _step(0.86, abs(height), f / radius))
    dots = math.sqrt(((turn * 6.0 - sector - 0.5) * 1.0) ** 2 + height * height)
    colour = _mix(colour, (0.12, 0.12, 0.16), 0.9 * (1.0 - _step(0.16, dots, f / radius)))
    return _scale(colour, 1.0 + 0.10 * _fbm(turn * 60.0, height * 20.0, f / radius * 20.0, seed))


@_jit
def _globe(x, y, z, f, seed):
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    turn, height = math.atan2(y, x), z / radius
    f = f / radius
    land = _fbm(2.2 * x / radius + 3.0, 2.2 * y / radius + 2.6 * height, 2.2 * f, seed) + 0.5 * _fbm(
        3.1 * height, 2.0 * x / radius, 3.0 * f, seed + 3
    )
    colour = _scale((0.10, 0.36, 0.62), 1.0 + 0.25 * height)
    ground = _mix((0.28, 0.52, 0.20), (0.76, 0.62, 0.34), min(max(2.2 * land, 0.0), 1.0))
    colour = _mix(colour, ground, _step(0.05, land, 2.0 * f))
    colour = _mix(colour, (0.95, 0.96, 0.97), _step(0.86 + 0.06 * land, abs(height), f))
    grid = max(
        _line((turn / 0.5236 - math.floor(turn / 0.5236 + 0.5)) * 0.5236, 0.012, f),
        _line(height * 4.0 - math.floor(height * 4.0 + 0.5), 0.03, 4.0 * f),
    )
    return _mix(colour, (0.93, 0.90, 0.78), 0.55 * grid)


@_jit
def _face(x, y, z, f, seed, tint):
    """A head that looks along -y: hair, eyes, brows, nose shadow, mouth."""
    radius = max(math.sqrt(x * x + y * y + z * z), 1e-6)
    a, b, f = x / radius, z / radius, f / radius
    skin = _scale(tint, 1.0 + 0.07 * _fbm(8.0 * a, 8.0 * b, 8.0 * f, seed))
    strands = 1.0 + 0.5 * _fbm(40.0 * a + 3.0 * b, 5.0 * b + 5.0 * y / radius, 40.0 * f, seed + 1)
    hair = _scale((0.24, 0.13, 0.06), strands)
    if y > 0.25 * radius:
        return hair
    fringe = 0.42 + 0.10 * a + 0.05 * _fbm(14.0 * a, 0.0, 14.0 * f, seed + 2) - 0.9 * max(abs(a) - 0.62, 0.0) * 3.0
    for side in (-1.0, 1.0):
        ex, ez = a - 0.30 * side, b - 0.08
        away = math.sqrt(ex * ex + 2.2 * ez * ez)
        skin = _mix(skin, (0.96, 0.96, 0.94), 1.0 - _step(0.14, away, f))
        skin = _mix(skin, (0.12, 0.30, 0.40), 1.0 - _step(0.085, away, f))
        skin = _mix(skin, (0.03, 0.03, 0.04), 1.0 - _step(0.045, away, f))
        brow = b - 0.27 + 0.5 * (ex * ex)
        skin = _mix(skin, (0.22, 0.12, 0.06), _line(brow, 0.028, f) * (1.0 - _step(0.17, abs(ex), f)))
        cheek = math.sqrt((a - 0.42 * side) ** 2 + (b + 0.25) ** 2)
        skin = _mix(skin, (0.86, 0.42, 0.36), 0.35 * (1.0 - _step(0.14, cheek, 0.2)))
    skin = _scale(skin, 1.0 - 0.25 * _line(a - 0.03, 0.05, 0.08) * _line(b + 0.12, 0.08, 0.1))
    smile = b + 0.40 - 0.9 * a * a
    skin = _mix(skin, (0.62, 0.16, 0.16), _line(smile, 0.045, f) * (1.0 - _step(0.27, abs(a), f)))
    return _mix(skin, hair, _step(fringe, b, f))


@_jit
def _shirt(x, y, z, f, seed, tint):
    around = math.atan2(y, x)
    thread = (
        1.0
        + 0.16 * _fbm(around * 14.0, z * 90.0, f * 90.0, seed)
        + 0.14 * _fbm(around * 2.0, z * 12.0, f * 12.0, seed + 1)
    )
    stripe = z / 0.085 - math.floor(z / 0.085)
    colour = _mix(tint, (0.93, 0.91, 0.86), _line(stripe - 0.5, 0.16, f / 0.085))
    colour = _mix(colour, (0.95, 0.78, 0.20), _line(stripe - 0.5, 0.04, f / 0.085))
    return _scale(colour, thread)


@_jit
def _leaf(u, v, f, seed, tint):
    vein = _line((abs(u) * 0.8 + v) / 0.05 - math.floor((abs(u) * 0.8 + v) / 0.05) - 0.5, 0.08, f / 0.05)
    mid = _line(u, 0.006, f)
    return _mix(
        _scale(tint, 1.0 + 0.3 * _fbm(u * 25.0, v * 25.0, f * 25.0, seed)), (0.62, 0.78, 0.40), 0.45 * vein + 0.5 * mid
    )


@_jit
def _view(u, v, f, seed):
    """What the window shows: sky, clouds, far hills, trees."""
    cloud = min(max(0.3 + 1.6 * _fbm(u * 3.0, v * 7.0, f * 7.0, seed), 0.0), 1.0)
    colour = _mix(_mix((0.80, 0.90, 0.98), (0.38, 0.62, 0.92), min(max(0.4 + v, 0.0), 1.0)), (0.98, 0.98, 0.98), cloud)
    hill = -0.10 + 0.09 * _fbm(u * 2.5, 1.0, f * 2.5, seed + 1)
    colour = _mix((0.42, 0.56, 0.50), colour, _step(hill, v, f))
    tree = -0.26 + 0.16 * _fbm(u * 9.0, 2.0, f * 9.0, seed + 2)
    leaves = 1.0 + 0.5 * _fbm(u * 30.0, v * 30.0, f * 30.0, seed + 3)
    return _mix(_scale((0.20, 0.38, 0.16), leaves), colour, _step(tree, v, f))


@_jit
def _checker(u, v, half, f, seed, tint):
    """A toy block: a frame of its colour, a checker inside."""
    square = (math.floor(u / (0.5 * half)) + math.floor(v / (0.5 * half))) % 2
    inner = _mix((0.95, 0.93, 0.86), (0.15, 0.15, 0.20), float(square))
    colour = _mix(inner, tint, _step(0.78 * half, max(abs(u), abs(v)), f))
    return _scale(colour, 1.0 + 0.12 * _fbm(u * 60.0, v * 60.0, f * 60.0, seed))


@_jit
def _fur(x, y, z, f, seed, tint):
    wobble = _fbm(9.0 * x + 5.0, 9.0 * z + 9.0 * y, 9.0 * f, seed)
    stripe = 0.5 + 0.5 * math.sin(75.0 * z + 14.0 * abs(x) + 3.5 * wobble)
    hair = 1.0 + 0.30 * _fbm(160.0 * x, 60.0 * z, 160.0 * f, seed + 1)
    return _scale(_mix(tint, (0.25, 0.13, 0.06), 0.7 * _step(0.55, stripe, 0.3)), hair)


@_jit
def _wall_of(normal):
    """Colour and texture of the room's faces: planks below, brick behind, plaster above, wallpaper at the sides."""
    if normal[2] > 0.5:
        return (0.60, 0.42, 0.27), PLANKS
    if normal[2] < -0.5:
        return (0.90, 0.89, 0.86), PLAIN
    if normal[1] < -0.5:
        return (0.66, 0.40, 0.31), BRICK
    return (0.66, 0.74, 0.70), WALLPAPER


@_jit
def paint(part, point, normal, footprint, size, material, tint, seed, albedo):
    """Linear reflectance of N surface points into `albedo` [N,4]; the last column is the share that glows.

    Args:
        part: [N]; point, normal: [N,3] in the part's own axes; footprint: [N] metres that a sample covers.
        size: [P,3], material: [P], tint: [P,3] display colour, seed: [P] of each part.
    """
    for i in range(len(part)):
        p = part[i]
        x, y, z, f, s = point[i, 0], point[i, 1], point[i, 2], footprint[i], seed[p]
        nx, ny, nz = abs(normal[i, 0]), abs(normal[i, 1]), abs(normal[i, 2])
        u, v = x, z
        if nz > nx and nz > ny:
            u, v = x, y
        elif nx > ny:
            u, v = y, z
        base, kind, glow = (tint[p, 0], tint[p, 1], tint[p, 2]), material[p], 0.0
        if kind == WALLS:
            base, kind = _wall_of(normal[i])
        if kind == WOOD:
            base = _wood(v, u, f, s, base) if size[p, 2] > size[p, 0] else _wood(u, v, f, s, base)
        elif kind == PLANKS:
            base = _planks(x, y, f, s, base)
        elif kind == BRICK:
            base = _brick(u, v, f, s, base)
        elif kind == WALLPAPER:
            base = _wallpaper(u, v, f, s, base)
        elif kind == RUG:
            base = _rug(x, y, f, s, base)
        elif kind == POSTER:
            base = _poster(u, v, f, s, base)
        elif kind == BOOKS:
            base = _books(u, v, f, s, base)
        elif kind == FABRIC:
            base = _fabric(u, v, f, s, base)
        elif kind == BEACH_BALL:
            base = _beach_ball(x, y, z, f, s)
        elif kind == GLOBE:
            base = _globe(x, y, z, f, s)
        elif kind == FACE:
            base = _face(x, y, z, f, s, base)
        elif kind == SHIRT:
            base = _shirt(x, y, z, f, s, base)
        elif kind == LEAF:
            base = _leaf(x, z, f, s, base)
        elif kind == VIEW:
            base, glow = _view(u, v, f, s), 1.6
        elif kind == GLOW:
            base, glow = _scale(base, 1.0 + 0.05 * _fbm(u * 60.0, v * 60.0, f * 60.0, s)), 2.2
        elif kind == CHECKER:
            base = _checker(u, v, size[p, 0], f, s, base)
        elif kind == FUR:
            base = _fur(x, y, z, f, s, base)
        else:
            base = _scale(
                base, 1.0 + 0.10 * _fbm(u * 7.0, v * 7.0, f * 7.0, s) + 0.07 * _fbm(u * 80.0, v * 80.0, f * 80.0, s + 1)
            )
        for c in range(3):
            value = min(max(base[c], 0.0), 1.0)
            albedo[i, c] = value * value  # display colour to linear light, gamma 2
        albedo[i, 3] = glow
