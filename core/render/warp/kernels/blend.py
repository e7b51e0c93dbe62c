"""Blend tiles front to back (Kerbl et al., 3D Gaussian splatting, 2023, equation 3): two layers merged by depth.

Gaussians that stand still are projected and listed once a frame, those that move at every step; a pixel walks both
lists at once, the nearer Gaussian first and of two at one depth the moving one, as if they had been sorted together.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.geometry import camera_vector
from streamlod.core.render.warp.kernels.rules import (
    ALPHA_MAX,
    BACKGROUND,
    NOWHERE,
    TILE_X,
    TILE_Y,
    TRANSMITTANCE_MIN,
    Layer,
    TileGrid,
)


@wp.func
def depth_at(layer: Layer, view: int, at: int, end: int) -> float:
    """Depth of entry `at` of a list, beyond everything behind its end."""
    depth = NOWHERE
    if at < end:
        depth = layer.conic[view, layer.ids[at]][3]
    return depth


@wp.func
def sigma_of(place: wp.vec4, conic: wp.vec4, x: float, y: float) -> float:
    """Half the squared distance of a pixel centre from the mean, in standard deviations."""
    dx = x - place[0]
    dy = y - place[1]
    return 0.5 * (conic[0] * dx * dx + conic[2] * dy * dy) + conic[1] * dx * dy


@wp.func
def pixel_of(tile: int, lane: int, grid: TileGrid) -> wp.vec2i:
    """Column and row of the pixel that a lane of a tile draws; may lie outside of the picture."""
    return wp.vec2i((tile % grid.tiles_x) * TILE_X + lane % TILE_X, (tile // grid.tiles_x) * TILE_Y + lane // TILE_X)


@wp.kernel(enable_backward=False, grid_stride=False, launch_bounds=(256, 4))
def blend(
    moving: Layer,
    still: Layer,
    chosen: wp.array[int],
    cameras: wp.array2d[float],
    grid: TileGrid,
    dirty: wp.array2d[int],
    base: wp.array3d[wp.vec3],
    image: wp.array3d[wp.vec3],
    light: wp.array3d[float],
) -> None:
    """Grid (views * tiles, pixels of a tile), a block a tile.

    Args:
        moving: of views; still: of cameras. chosen: [V] camera of each view. cameras: [C,25].
        dirty: [C,tiles] nonzero for tiles to draw; the others show `base` [C,H,W].
        image: out, [V,H,W]. light: out, [V,H,W] what of the background shows.
    """
    row, lane = wp.tid()
    v = row // grid.tiles
    tile = row - v * grid.tiles
    c = chosen[v]
    pixel = pixel_of(tile, lane, grid)
    if pixel[0] >= grid.width or pixel[1] >= grid.height:
        return
    if dirty[c, tile] == 0:
        image[v, pixel[1], pixel[0]] = base[c, pixel[1], pixel[0]]
        light[v, pixel[1], pixel[0]] = 1.0
        return
    x = float(pixel[0]) + 0.5
    y = float(pixel[1]) + 0.5
    m = moving.first[row]
    m_end = moving.last[row]
    s = still.first[c * grid.tiles + tile]
    s_end = still.last[c * grid.tiles + tile]
    m_depth = depth_at(moving, v, m, m_end)
    s_depth = depth_at(still, c, s, s_end)
    passing = float(1.0)
    colour = wp.vec3(0.0, 0.0, 0.0)
    alive = bool(True)
    while alive and (m < m_end or s < s_end):
        place = wp.vec4()
        conic = wp.vec4()
        own = wp.vec3()
        if m_depth <= s_depth:
            i = moving.ids[m]
            place = moving.place[v, i]
            conic = moving.conic[v, i]
            own = moving.colour[v, i]
            m += 1
            m_depth = depth_at(moving, v, m, m_end)
        else:
            i = still.ids[s]
            place = still.place[c, i]
            conic = still.conic[c, i]
            own = still.colour[c, i]
            s += 1
            s_depth = depth_at(still, c, s, s_end)
        sigma = sigma_of(place, conic, x, y)
        if sigma <= place[3]:
            alpha = wp.min(place[2] * wp.exp(-sigma), ALPHA_MAX)
            absorbed = alpha * passing
            if passing - absorbed > TRANSMITTANCE_MIN:
                colour += own * absorbed
                passing -= absorbed
            else:
                alive = False
    image[v, pixel[1], pixel[0]] = colour + camera_vector(cameras, c, BACKGROUND) * passing
    light[v, pixel[1], pixel[0]] = passing
