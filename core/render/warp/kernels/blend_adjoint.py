"""Gradients of blending, front to back like the forward pass (the mathematics of `core.render.cpu.kernels.backward`).

With g = dL/dpixel and C_i the colours, `behind` = g . (what lies behind) starts as g . C_final and loses w_i g . C_i at
each Gaussian; then dL/dsigma_i = alpha behind / (1 - alpha) - w_i g . C_i. Nothing but the picture is kept from the
forward pass; transmittances are computed again. Lanes of a warp add up before one of them writes.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.blend import depth_at, pixel_of, sigma_of
from streamlod.core.render.warp.kernels.lanes import any_lane, is_first_lane, lanes_sum
from streamlod.core.render.warp.kernels.rules import ALPHA_MAX, TRANSMITTANCE_MIN, Layer, TileGrid


@wp.kernel(enable_backward=False, grid_stride=False)
def differentiate_blend(
    moving: Layer,
    still: Layer,
    chosen: wp.array[int],
    grid: TileGrid,
    image: wp.array3d[wp.vec3],
    light: wp.array3d[float],
    by_image: wp.array3d[wp.vec3],
    by_light: wp.array3d[float],
    sums: wp.array3d[float],
) -> None:
    """Grid (views * tiles, pixels of a tile), a block a tile.

    Args:
        moving, still, chosen: as for `blend`; `image` and `light` [V,H,W] are its result.
        by_image: [V,H,W] the loss's gradient; by_light: likewise, or empty where it is zero.
        sums: in and out, [V,G,9] of the moving Gaussians (`rules`).
    """
    row, lane = wp.tid()
    v = row // grid.tiles
    tile = row - v * grid.tiles
    c = chosen[v]
    pixel = pixel_of(tile, lane, grid)
    alive = pixel[0] < grid.width and pixel[1] < grid.height
    x = float(pixel[0]) + 0.5
    y = float(pixel[1]) + 0.5
    g = wp.vec3(0.0, 0.0, 0.0)
    behind = float(0.0)
    if alive:
        g = by_image[v, pixel[1], pixel[0]]
        behind = wp.dot(g, image[v, pixel[1], pixel[0]])
        if by_light.shape[0] > 0:
            behind += by_light[v, pixel[1], pixel[0]] * light[v, pixel[1], pixel[0]]
    m = moving.first[row]
    m_end = moving.last[row]
    s = still.first[c * grid.tiles + tile]
    s_end = still.last[c * grid.tiles + tile]
    m_depth = depth_at(moving, v, m, m_end)
    s_depth = depth_at(still, c, s, s_end)
    passing = float(1.0)
    while m < m_end and any_lane(alive):  # behind the last moving Gaussian nothing wants gradients
        place = wp.vec4()
        conic = wp.vec4()
        own = wp.vec3()
        i = int(-1)
        if m_depth <= s_depth:
            i = moving.ids[m]
            place = moving.place[v, i]
            conic = moving.conic[v, i]
            own = moving.colour[v, i]
            m += 1
            m_depth = depth_at(moving, v, m, m_end)
        else:
            j = still.ids[s]
            place = still.place[c, j]
            conic = still.conic[c, j]
            own = still.colour[c, j]
            s += 1
            s_depth = depth_at(still, c, s, s_end)
        sigma = sigma_of(place, conic, x, y)
        weight = float(0.0)
        slope = float(0.0)
        reached = alive and sigma <= place[3]
        if reached:
            full = place[2] * wp.exp(-sigma)
            alpha = wp.min(full, ALPHA_MAX)
            absorbed = alpha * passing
            if passing - absorbed > TRANSMITTANCE_MIN:
                weight = absorbed
                passing -= absorbed
                share = weight * wp.dot(own, g)
                behind -= share
                if full < ALPHA_MAX:
                    slope = alpha * behind / (1.0 - alpha) - share
            else:
                alive = False
        if i >= 0 and any_lane(weight > 0.0):
            dx = x - place[0]
            dy = y - place[1]
            red = lanes_sum(weight * g[0])
            green = lanes_sum(weight * g[1])
            blue = lanes_sum(weight * g[2])
            s_1 = lanes_sum(slope)
            s_x = lanes_sum(slope * dx)
            s_y = lanes_sum(slope * dy)
            s_xx = lanes_sum(slope * dx * dx)
            s_xy = lanes_sum(slope * dx * dy)
            s_yy = lanes_sum(slope * dy * dy)
            if is_first_lane():
                wp.atomic_add(sums, v, i, 0, red)
                wp.atomic_add(sums, v, i, 1, green)
                wp.atomic_add(sums, v, i, 2, blue)
                wp.atomic_add(sums, v, i, 3, s_1)
                wp.atomic_add(sums, v, i, 4, s_x)
                wp.atomic_add(sums, v, i, 5, s_y)
                wp.atomic_add(sums, v, i, 6, s_xx)
                wp.atomic_add(sums, v, i, 7, s_xy)
                wp.atomic_add(sums, v, i, 8, s_yy)
