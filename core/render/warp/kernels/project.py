"""Gaussians to ellipses in pictures, and one key (view, tile, depth) for each tile that an ellipse reaches."""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.geometry import (
    camera_rotation,
    camera_vector,
    held_slopes,
    rotation,
    row_to_picture,
    unit_quaternion,
)
from streamlod.core.render.warp.kernels.rules import (
    ALPHA_MIN,
    CENTRE_X,
    CENTRE_Y,
    COLOUR_MAX,
    FAR,
    FINITE,
    FOCAL_X,
    FOCAL_Y,
    GAIN,
    LOW_PASS,
    MAX_ASIDE,
    MAX_SLOPE,
    MAX_SPREAD,
    MIN_DETERMINANT,
    NEAR,
    OFFSET,
    OPACITY_MAX,
    SLACK,
    TILE_X,
    TILE_Y,
    Cloud,
    Layer,
    TileGrid,
)


@wp.struct
class Ellipse:
    """A Gaussian in a picture, if `drawn`: covariance after the low-pass, and its determinant."""

    drawn: bool
    x: float
    y: float
    depth: float
    xx: float
    xy: float
    yy: float
    determinant: float


@wp.func
def ellipse_of(
    mean: wp.vec3, quaternion: wp.vec4, scale: wp.vec3, cameras: wp.array2d[float], c: int, grid: TileGrid
) -> Ellipse:
    """Every test is written such that a Gaussian with a NaN is not drawn."""
    e = Ellipse()
    e.drawn = False
    turn = camera_rotation(cameras, c)
    p = turn * mean + camera_vector(cameras, c, 9)
    z = p[2]
    if not (z > NEAR) or not (z < FAR):
        return e
    inverse_z = 1.0 / z
    wide = float(grid.width)
    high = float(grid.height)
    e.x = cameras[c, FOCAL_X] * p[0] * inverse_z + cameras[c, CENTRE_X]
    e.y = cameras[c, FOCAL_Y] * p[1] * inverse_z + cameras[c, CENTRE_Y]
    e.depth = z
    close = wp.abs(e.x - 0.5 * wide) <= MAX_ASIDE * wide and wp.abs(e.y - 0.5 * high) <= MAX_ASIDE * high
    if not close and not (p[0] * p[0] + p[1] * p[1] <= MAX_SLOPE * MAX_SLOPE * z * z):
        return e
    held = held_slopes(cameras, c, p, grid.width, grid.height)
    forward = wp.vec3(turn[2, 0], turn[2, 1], turn[2, 2])
    across = row_to_picture(
        wp.vec3(turn[0, 0], turn[0, 1], turn[0, 2]), forward, cameras[c, FOCAL_X], held[0], inverse_z
    )
    down = row_to_picture(wp.vec3(turn[1, 0], turn[1, 1], turn[1, 2]), forward, cameras[c, FOCAL_Y], held[1], inverse_z)
    back = wp.transpose(rotation(unit_quaternion(quaternion)))
    along = wp.cw_mul(back * forward, scale)
    if not (wp.dot(along, along) <= MAX_SPREAD * MAX_SPREAD * z * z):
        return e
    a = wp.cw_mul(back * across, scale)
    b = wp.cw_mul(back * down, scale)
    xx = wp.dot(a, a)
    yy = wp.dot(b, b)
    minors = wp.cross(a, b)  # det(P P^T) as a sum of squared minors (Cauchy-Binet): no cancellation for needles
    e.determinant = wp.dot(minors, minors) + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
    e.xx = xx + LOW_PASS
    e.xy = wp.dot(a, b)
    e.yy = yy + LOW_PASS
    sound = wp.abs(e.x) + wp.abs(e.y) + e.determinant < FINITE
    e.drawn = sound and e.determinant > MIN_DETERMINANT
    return e


@wp.func
def tiles_of_row(place: wp.vec4, conic: wp.vec4, skew: float, determinant: float, box: wp.vec4i, row: int) -> wp.vec2i:
    """Tiles [start, stop) of a row that the ellipse alpha = 1/255 touches, within its box.

    Over a band of heights the ends lie at the band's edge or at the tangent points dy = -+skew.
    """
    start = box[0]
    stop = box[2]
    if box[2] - box[0] > 1 and box[3] - box[1] > 1:
        top = float(row * TILE_Y) + 0.5 - place[1]
        bottom = top + float(TILE_Y - 1)
        inverse_a = 1.0 / conic[0]
        reach = 2.0 * place[3] * conic[0]
        dy = wp.clamp(-skew, top, bottom)
        left = -conic[1] * inverse_a * dy - wp.sqrt(wp.max(0.0, reach - dy * dy / determinant)) * inverse_a
        dy = wp.clamp(skew, top, bottom)
        right = -conic[1] * inverse_a * dy + wp.sqrt(wp.max(0.0, reach - dy * dy / determinant)) * inverse_a
        x = place[0] - 0.5
        # held before they become integers, which are too small for the ends of the longest needles
        first = wp.clamp((x + left) / float(TILE_X) - SLACK, float(box[0]), float(box[2]))
        last = wp.clamp((x + right) / float(TILE_X) + SLACK, float(box[0] - 1), float(box[2] - 1))
        start = int(wp.floor(first))
        stop = int(wp.floor(last)) + 1
    return wp.vec2i(start, stop)


@wp.func
def box_of(e: Ellipse, cut: float, grid: TileGrid) -> wp.vec4i:
    """Tiles left, top, right, bottom of the box of the ellipse where sigma is `cut`; ends exclusive, empty for none."""
    wide = float(grid.width)
    high = float(grid.height)
    extent_x = wp.sqrt(2.0 * cut * e.xx)
    extent_y = wp.sqrt(2.0 * cut * e.yy)
    left = e.x - extent_x - 0.5
    right = e.x + extent_x - 0.5
    top = e.y - extent_y - 0.5
    bottom = e.y + extent_y - 0.5
    box = wp.vec4i(0, 0, 0, 0)
    if right >= 0.0 and bottom >= 0.0 and left <= wide - 1.0 and top <= high - 1.0:
        first_x = int(wp.ceil(wp.max(left, 0.0)))
        last_x = int(wp.floor(wp.min(right, wide - 1.0)))
        first_y = int(wp.ceil(wp.max(top, 0.0)))
        last_y = int(wp.floor(wp.min(bottom, high - 1.0)))
        if last_x >= first_x and last_y >= first_y:  # otherwise between pixel centres
            box = wp.vec4i(first_x // TILE_X, first_y // TILE_Y, last_x // TILE_X + 1, last_y // TILE_Y + 1)
    return box


@wp.kernel(enable_backward=False, grid_stride=False)
def project(
    count: wp.array[int],
    cloud: Cloud,
    chosen: wp.array[int],
    cameras: wp.array2d[float],
    grid: TileGrid,
    layer: Layer,
    keys: wp.array[wp.uint64],
    wanted: wp.array[wp.int64],
    dirty: wp.array2d[int],
) -> None:
    """Grid (views, capacity of Gaussians).

    Args:
        count: [1] Gaussians that exist. chosen: [V] camera of each view. cameras: [C,25].
        layer: out, but for its ranges. keys: out, [2*pairs], `NO_KEY` everywhere.
        wanted: in and out, [1] pairs of Gaussian and tile, also those that have no room and are left out.
        dirty: out, [C,tiles] 1 where a tile is reached; others are left as they are.
    """
    v, i = wp.tid()
    layer.place[v, i] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if i >= count[0]:
        return
    c = chosen[v]
    d = wp.min(v, cloud.means.shape[0] - 1)
    opacity = cloud.opacities[d, i]
    own = cloud.colours[d, i]
    colour = wp.cw_mul(camera_vector(cameras, c, GAIN), own) + camera_vector(cameras, c, OFFSET)
    if not (opacity >= ALPHA_MIN) or not (opacity < FINITE):
        return
    if not (wp.abs(colour[0]) + wp.abs(colour[1]) + wp.abs(colour[2]) < COLOUR_MAX):
        return
    e = ellipse_of(cloud.means[d, i], cloud.quaternions[d, i], cloud.scales[d, i], cameras, c, grid)
    if not e.drawn:
        return
    opacity = wp.min(opacity, OPACITY_MAX)
    cut = wp.log(opacity * 255.0)
    box = box_of(e, cut, grid)
    inverse = 1.0 / e.determinant
    place = wp.vec4(e.x, e.y, opacity, cut)
    conic = wp.vec4(e.yy * inverse, -e.xy * inverse, e.xx * inverse, e.depth)
    skew = e.xy / e.xx * wp.sqrt(2.0 * cut * e.xx)
    pairs = int(0)
    for row in range(box[1], box[3]):
        span = tiles_of_row(place, conic, skew, e.determinant, box, row)
        pairs += wp.max(span[1] - span[0], 0)
    if pairs == 0:
        return
    layer.place[v, i] = place
    layer.conic[v, i] = conic
    layer.colour[v, i] = colour
    place_in_list = wp.atomic_add(wanted, 0, wp.int64(pairs))
    if place_in_list > wp.int64(layer.ids.shape[0] // 2 - pairs):
        return  # `wanted` tells
    at = int(place_in_list)
    depth = wp.uint64(wp.cast(e.depth, wp.uint32))
    for row in range(box[1], box[3]):
        span = tiles_of_row(place, conic, skew, e.determinant, box, row)
        for column in range(span[0], span[1]):
            tile = row * grid.tiles_x + column
            keys[at] = (wp.uint64(v * grid.tiles + tile) << wp.uint64(32)) | depth
            layer.ids[at] = i
            dirty[c, tile] = 1
            at += 1


@wp.func
def order_by_row(layer: Layer, first: int, end: int) -> None:
    """Sort entries [first, end) of a list (Shell 1959), which lie at one depth: threads list them in any order."""
    gap = int(end - first)
    while gap > 1:
        gap = gap // 2
        for p in range(first + gap, end):
            i = layer.ids[p]
            q = int(p)
            while q - gap >= first and layer.ids[q - gap] > i:
                layer.ids[q] = layer.ids[q - gap]
                q -= gap
            layer.ids[q] = i


@wp.kernel(enable_backward=False, grid_stride=False)
def find_ranges(keys: wp.array[wp.uint64], layer: Layer) -> None:
    """Where each tile's list begins and ends; ties of depth by row. Grid: the capacity of pairs.

    Tiles without any stay as they are.
    """
    p = wp.tid()
    key = keys[p]
    none = wp.uint64(0xFFFFFFFFFFFFFFFF)
    if key == none:
        return
    pairs = layer.ids.shape[0] // 2
    tile = int(key >> wp.uint64(32))
    before = none
    if p > 0:
        before = keys[p - 1]
    after = none
    if p + 1 < pairs:
        after = keys[p + 1]
    if before == none or int(before >> wp.uint64(32)) != tile:
        layer.first[tile] = p
    if after == none or int(after >> wp.uint64(32)) != tile:
        layer.last[tile] = p + 1
    if before != key and after == key:
        end = int(p + 2)
        while end < pairs and keys[end] == key:
            end += 1
        order_by_row(layer, p, end)
