"""The colour of surface points, by the textures of their parts."""

from __future__ import annotations

import numba

from streamlod.core.arrays import Float64, Int32
from streamlod.core.synthetic.textures import numbers as T
from streamlod.core.synthetic.textures.furnishings import books, fabric, glowing, plain, poster, screen
from streamlod.core.synthetic.textures.living import face, fur, leaf, shirt
from streamlod.core.synthetic.textures.outdoors import foliage, grass, heaven, view
from streamlod.core.synthetic.textures.surfaces import brick, planks, rug, smooth_walls_of, wall_of, wallpaper, wood
from streamlod.core.synthetic.textures.toys import beach_ball, checker, globe

_jit = numba.njit(cache=True, nogil=True, fastmath=True)


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
        if kind == T.WALLS:
            base, kind = wall_of(normal[i])
        if kind == T.WOOD:
            base = wood(v, u, f, s, base) if size[p, 2] > size[p, 0] else wood(u, v, f, s, base)
        elif kind == T.PLANKS:
            base = planks(x, y, f, s, base)
        elif kind == T.BRICK:
            base = brick(u, v, f, s, base)
        elif kind == T.WALLPAPER:
            base = wallpaper(u, v, f, s, base)
        elif kind == T.RUG:
            base = rug(x, y, f, s, base)
        elif kind == T.POSTER:
            base = poster(u, v, f, s, base)
        elif kind == T.BOOKS:
            base = books(u, v, f, s, base)
        elif kind == T.FABRIC:
            base = fabric(u, v, f, s, base)
        elif kind == T.BEACH_BALL:
            base = beach_ball(x, y, z, f, s)
        elif kind == T.GLOBE:
            base = globe(x, y, z, f, s)
        elif kind == T.FACE:
            base = face(x, y, z, f, s, base)
        elif kind == T.SHIRT:
            base = shirt(x, y, z, f, s, base)
        elif kind == T.LEAF:
            base = leaf(x, z, f, s, base)
        elif kind == T.VIEW:
            base, glow = view(u, v, f, s), 1.6
        elif kind == T.GLOW:
            base, glow = glowing(u, v, f, s, base), 2.2
        elif kind == T.CHECKER:
            base = checker(u, v, size[p, 0], f, s, base)
        elif kind == T.SMOOTH:
            pass
        elif kind == T.SMOOTH_WALLS:
            base = smooth_walls_of(normal[i], x, y, f, s)
        elif kind == T.SCREEN:
            base, glow = screen(u, v, f, s), 1.1
        elif kind == T.HEAVEN:
            base, glow = heaven(x, y, z, f, s), 1.0
        elif kind == T.GRASS:
            base = grass(u, v, f, s, base)
        elif kind == T.FOLIAGE:
            base = foliage(x, y, z, f, s, base)
        elif kind == T.FUR:
            base = fur(x, y, z, f, s, base)
        else:
            base = plain(u, v, f, s, base)
        for c in range(3):
            value = min(max(base[c], 0.0), 1.0)
            albedo[i, c] = value * value  # display colour to linear light, gamma 2
        albedo[i, 3] = glow
