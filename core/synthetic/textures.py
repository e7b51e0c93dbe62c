"""Procedural textures: the colour of a surface point from its place on its part.

Detail finer than a pixel's footprint is faded out, so that what two cameras see of one spot agrees.
"""

from __future__ import annotations

import math

import numba

from streamlod.core.arrays import Float64, Int32
from streamlod.core.synthetic.noise import Colour, fbm, line, mix, scale, scatter, step

PLAIN, WOOD, PLANKS, BRICK, WALLPAPER, RUG, POSTER, BOOKS = 0, 1, 2, 3, 4, 5, 6, 7
FABRIC, BEACH_BALL, GLOBE, FACE, SHIRT, LEAF, GLOW, VIEW, CHECKER, FUR, WALLS = 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18
SMOOTH, SMOOTH_WALLS, SCREEN, HEAVEN, GRASS, FOLIAGE = 19, 20, 21, 22, 23, 24

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def _hue(h: float) -> Colour:
    """A warm, muted colour for a hue in [0, 1]."""
    return (
        0.55 + 0.27 * math.cos(6.2832 * h),
        0.51 + 0.23 * math.cos(6.2832 * (h - 0.36)),
        0.48 + 0.25 * math.cos(6.2832 * (h - 0.67)),
    )


@_jit
def _wood(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    ring = fbm(u * 2.0, v * 22.0, f * 22.0, seed) + 0.5 * math.sin(
        30.0 * (v + 0.06 * fbm(u * 1.5, v * 4.0, f * 4.0, seed + 5))
    )
    grain = fbm(u * 14.0, v * 190.0, f * 190.0, seed + 9)
    return scale(tint, 1.0 + 0.16 * ring + 0.12 * grain)


@_jit
def _planks(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    row = math.floor(u / 0.145)
    across = u / 0.145 - row
    shift = v / 1.15 + scatter(row, 3, seed)
    board = math.floor(shift)
    along = shift - board
    tone = 0.72 + 0.5 * scatter(row, board, seed + 1)
    colour = _wood(v, u + 7.3 * scatter(row, board, seed + 2), f, seed + 3, scale(tint, tone))
    seam = max(line(min(across, 1.0 - across) * 0.145, 0.0022, f), line(min(along, 1.0 - along) * 1.15, 0.002, f))
    return scale(colour, 1.0 - 0.65 * seam)


@_jit
def _brick(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
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
def _wallpaper(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    x, y = u / 0.16, v / 0.16
    i, j = math.floor(x), math.floor(y + 0.5 * (math.floor(x) % 2))
    a, b = x - i - 0.5, y + 0.5 * (i % 2) - j - 0.5
    radius, angle = math.sqrt(a * a + b * b), math.atan2(b, a)
    petal = 0.24 + 0.11 * math.cos(6.0 * angle + 6.28 * scatter(i, j, seed))
    colour = scale(
        tint,
        1.0 + 0.10 * fbm(u * 9.0, v * 9.0, f * 9.0, seed + 1) + 0.06 * fbm(u * 70.0, v * 70.0, f * 70.0, seed + 6),
    )
    accent = _hue(scatter(i, j, seed + 2))
    colour = mix(colour, mix(colour, accent, 0.55), 1.0 - step(petal, radius, f / 0.16))
    colour = mix(colour, (0.93, 0.88, 0.72), 1.0 - step(0.07, radius, f / 0.16))
    return mix(colour, scale(tint, 0.62), 0.6 * line(a - 0.5, 0.035, f / 0.16))


@_jit
def _rug(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    edge = min(1.25 - abs(u), 0.95 - abs(v))
    weave = 1.0 + 0.20 * fbm(u * 95.0, v * 95.0, f * 95.0, seed) + 0.14 * fbm(u * 6.0, v * 6.0, f * 6.0, seed + 1)
    x, y = u / 0.25, v / 0.25
    i, j = math.floor(x + 0.5), math.floor(y + 0.5)
    diamond = abs(x - i) + abs(y - j)
    colour = mix(tint, _hue(0.58 + 0.25 * scatter(abs(i), abs(j), seed + 2)), 1.0 - step(0.40, diamond, f / 0.25))
    colour = mix(colour, (0.90, 0.82, 0.62), 1.0 - step(0.19, diamond, f / 0.25))
    colour = mix(colour, (0.25, 0.06, 0.08), 1.0 - step(0.09, diamond, f / 0.25))
    if edge < 0.26:
        saw = abs((u + v) / 0.12 - math.floor((u + v) / 0.12) - 0.5)
        band = mix((0.16, 0.20, 0.38), (0.86, 0.66, 0.30), step(0.25, saw, f / 0.12))
        colour = mix(colour, band, 1.0 - step(0.24, edge, f))
        colour = mix(colour, (0.88, 0.84, 0.74), line(edge - 0.235, 0.012, f) + line(edge - 0.05, 0.016, f))
    return scale(colour, weave)


@_jit
def _poster(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    """Abstract art: a sky of brush strokes, a sun, hills and a few bars; `tint` sets the mood."""
    colour = mix(tint, _hue(scatter(1, 1, seed)), min(max(0.5 + 1.6 * v, 0.0), 1.0))
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
        colour = mix(colour, _hue(scatter(k, 5, seed)), 0.9 * (1.0 - step(radius, away, f)))
        colour = mix(colour, (0.08, 0.08, 0.10), line(away - radius - 0.02, 0.004, f))
    for k in range(3):
        hill = (
            -0.06
            - 0.06 * k
            + 0.05 * math.sin(9.0 * u + 6.0 * scatter(k, 7, seed))
            + 0.03 * fbm(u * 18.0, float(k), f * 18.0, seed + k)
        )
        shade = scale(_hue(scatter(k, 6, seed)), 0.75 - 0.18 * k)
        colour = mix(shade, colour, step(hill, v, f))
    return colour


@_jit
def _books(u: float, v: float, f: float, seed: int, _tint: Colour) -> Colour:
    """A row of book spines of two widths, with bands and lettering."""
    i = math.floor(u / 0.083)
    x = u / 0.083 - i
    split = 0.3 + 0.4 * scatter(i, 1, seed)
    left = x < split
    number = 2 * i + (0 if left else 1)
    half = 0.5 * 0.083 * (split if left else 1.0 - split)
    centre = (0.5 * split if left else 0.5 + 0.5 * split) * 0.083
    off = x * 0.083 - centre
    colour = scale(_hue(scatter(number, 2, seed)), 0.55 + 0.5 * scatter(number, 3, seed))
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
def _fabric(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    thread = 0.24 * fbm(u * 120.0, v * 120.0, f * 120.0, seed) + 0.16 * fbm(u * 12.0, v * 12.0, f * 12.0, seed + 1)
    check = line((u / 0.11 - math.floor(u / 0.11) - 0.5) * 0.11, 0.014, f) + line(
        (v / 0.11 - math.floor(v / 0.11) - 0.5) * 0.11, 0.014, f
    )
    return scale(mix(tint, (0.88, 0.84, 0.76), 0.22 * check), 1.0 + thread)


@_jit
def _beach_ball(x: float, y: float, z: float, f: float, seed: int) -> Colour:
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
def _globe(x: float, y: float, z: float, f: float, seed: int) -> Colour:
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
def _face(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
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
def _shirt(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
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
def _leaf(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    vein = line((abs(u) * 0.8 + v) / 0.05 - math.floor((abs(u) * 0.8 + v) / 0.05) - 0.5, 0.08, f / 0.05)
    mid = line(u, 0.006, f)
    return mix(
        scale(tint, 1.0 + 0.3 * fbm(u * 25.0, v * 25.0, f * 25.0, seed)), (0.62, 0.78, 0.40), 0.45 * vein + 0.5 * mid
    )


@_jit
def _view(u: float, v: float, f: float, seed: int) -> Colour:
    """The view from the window: sky, clouds, far hills, trees."""
    cloud = min(max(0.3 + 1.6 * fbm(u * 3.0, v * 7.0, f * 7.0, seed), 0.0), 1.0)
    colour = mix(mix((0.80, 0.90, 0.98), (0.38, 0.62, 0.92), min(max(0.4 + v, 0.0), 1.0)), (0.98, 0.98, 0.98), cloud)
    hill = -0.10 + 0.09 * fbm(u * 2.5, 1.0, f * 2.5, seed + 1)
    colour = mix((0.42, 0.56, 0.50), colour, step(hill, v, f))
    tree = -0.26 + 0.16 * fbm(u * 9.0, 2.0, f * 9.0, seed + 2)
    leaves = 1.0 + 0.5 * fbm(u * 30.0, v * 30.0, f * 30.0, seed + 3)
    return mix(scale((0.20, 0.38, 0.16), leaves), colour, step(tree, v, f))


@_jit
def _checker(u: float, v: float, half: float, f: float, seed: int, tint: Colour) -> Colour:
    """A toy block: a frame of its colour, a checker inside."""
    square = (math.floor(u / (0.5 * half)) + math.floor(v / (0.5 * half))) % 2
    inner = mix((0.95, 0.93, 0.86), (0.15, 0.15, 0.20), float(square))
    colour = mix(inner, tint, step(0.78 * half, max(abs(u), abs(v)), f))
    return scale(colour, 1.0 + 0.12 * fbm(u * 60.0, v * 60.0, f * 60.0, seed))


@_jit
def _fur(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    wobble = fbm(9.0 * x + 5.0, 9.0 * z + 9.0 * y, 9.0 * f, seed)
    stripe = 0.5 + 0.5 * math.sin(75.0 * z + 14.0 * abs(x) + 3.5 * wobble)
    hair = 1.0 + 0.30 * fbm(160.0 * x, 60.0 * z, 160.0 * f, seed + 1)
    return scale(mix(tint, (0.25, 0.13, 0.06), 0.7 * step(0.55, stripe, 0.3)), hair)


@_jit
def _wall_of(normal: Float64) -> tuple[Colour, int]:
    """Colour and texture of the room's faces: planks below, brick behind, plaster above, wallpaper at the sides."""
    if normal[2] > 0.5:
        return (0.60, 0.42, 0.27), PLANKS
    if normal[2] < -0.5:
        return (0.90, 0.89, 0.86), PLAIN
    if normal[1] < -0.5:
        return (0.66, 0.40, 0.31), BRICK
    return (0.66, 0.74, 0.70), WALLPAPER


@_jit
def _smooth_walls_of(normal: Float64, u: float, v: float, f: float, seed: int) -> Colour:
    """Plain painted walls and ceiling; below, pale boards with hardly any grain."""
    if normal[2] > 0.5:
        return mix(_planks(u, v, f, seed, (0.78, 0.70, 0.60)), (0.76, 0.69, 0.60), 0.75)
    if normal[2] < -0.5:
        return 0.93, 0.93, 0.92
    if normal[1] < -0.5:
        return 0.88, 0.87, 0.84
    return 0.86, 0.88, 0.88


@_jit
def _screen(u: float, v: float, f: float, seed: int) -> Colour:
    """The picture on a screen: a bar above, lines of text, a chart."""
    colour = (0.90, 0.93, 0.97)
    row = math.floor(v / 0.045)
    length = 0.15 + 0.35 * scatter(row, 1, seed)
    text = line(v / 0.045 - row - 0.5, 0.18, f / 0.045) * (1.0 - step(length - 0.55, u, f)) * step(-0.55, u, f)
    colour = mix(colour, (0.25, 0.28, 0.34), 0.8 * text * (1.0 - step(-0.02, u, f)))
    bar = math.floor(u / 0.07)
    height = -0.25 + 0.35 * scatter(bar, 2, seed)
    chart = line(u / 0.07 - bar - 0.5, 0.35, f / 0.07) * (1.0 - step(height, v, f)) * step(0.06, u, f)
    colour = mix(colour, _hue(scatter(bar, 3, seed)), chart)
    return mix(colour, (0.12, 0.30, 0.55), step(0.26, v, f))


@_jit
def _heaven(x: float, y: float, z: float, f: float, seed: int) -> Colour:
    """The sky in a direction: blue, paler towards the horizon, with clouds on a flat ceiling far above."""
    away = math.sqrt(x * x + y * y + z * z)
    height = max(z / away, 0.0) + 0.12
    u, v, f = x / away / height, y / away / height, f / away / (height * height)
    cloud = min(max(0.25 + 1.7 * fbm(u * 1.1, v * 1.1, f * 1.1, seed), 0.0), 1.0)
    colour = mix((0.86, 0.91, 0.96), (0.36, 0.58, 0.90), min(1.6 * (height - 0.12), 1.0))
    return mix(colour, (0.97, 0.97, 0.97), 0.9 * cloud * min(12.0 * (height - 0.12), 1.0))


@_jit
def _grass(u: float, v: float, f: float, seed: int, tint: Colour) -> Colour:
    patch = fbm(u * 0.35, v * 0.35, f * 0.35, seed)
    blades = fbm(u * 8.0, v * 8.0, f * 8.0, seed + 1) + 0.6 * fbm(u * 45.0, v * 45.0, f * 45.0, seed + 2)
    return scale(mix(tint, (0.55, 0.52, 0.26), min(max(0.3 + 0.8 * patch, 0.0), 1.0)), 1.0 + 0.35 * blades)


@_jit
def _foliage(x: float, y: float, z: float, f: float, seed: int, tint: Colour) -> Colour:
    clumps = fbm(4.0 * x + 3.0 * z, 4.0 * y - 2.0 * z, 4.0 * f, seed)
    leaves = fbm(17.0 * x - 9.0 * z, 17.0 * y + 14.0 * z, 17.0 * f, seed + 1)
    return scale(tint, 0.85 + 0.55 * clumps + 0.5 * leaves)


@_jit
def paint(  # noqa: PLR0912, PLR0915 - one branch a texture is the table that compiles
    part: Int32,
    point: Float64,
    normal: Float64,
    footprint: Float64,
    size: Float64,
    material: Int32,
    tint: Float64,
    seed: Int32,
    albedo: Float64,
) -> None:
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
            base, glow = scale(base, 1.0 + 0.05 * fbm(u * 60.0, v * 60.0, f * 60.0, s)), 2.2
        elif kind == CHECKER:
            base = _checker(u, v, size[p, 0], f, s, base)
        elif kind == SMOOTH:
            pass
        elif kind == SMOOTH_WALLS:
            base = _smooth_walls_of(normal[i], x, y, f, s)
        elif kind == SCREEN:
            base, glow = _screen(u, v, f, s), 1.1
        elif kind == HEAVEN:
            base, glow = _heaven(x, y, z, f, s), 1.0
        elif kind == GRASS:
            base = _grass(u, v, f, s, base)
        elif kind == FOLIAGE:
            base = _foliage(x, y, z, f, s, base)
        elif kind == FUR:
            base = _fur(x, y, z, f, s, base)
        else:
            base = scale(
                base, 1.0 + 0.10 * fbm(u * 7.0, v * 7.0, f * 7.0, s) + 0.07 * fbm(u * 80.0, v * 80.0, f * 80.0, s + 1)
            )
        for c in range(3):
            value = min(max(base[c], 0.0), 1.0)
            albedo[i, c] = value * value  # display colour to linear light, gamma 2
        albedo[i, 3] = glow
