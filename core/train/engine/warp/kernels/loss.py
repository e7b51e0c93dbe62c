"""L1 and D-SSIM of the dirty tiles of all views, and their gradient (`core.train.loss.photometric`).

Four passes: lines of the moments; columns of them, SSIM and its derivatives by the moments; lines of these; columns of
these and the gradient. What is not near a dirty tile is passed over.
"""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.lanes import is_first_lane, lanes_sum
from streamlod.core.render.warp.kernels.rules import TILE_X, TILE_Y, TileGrid
from streamlod.core.train.engine.warp.kernels.layout import DSSIM_WEIGHT, SUM_LOSS

REACH = wp.constant(5)  # pixels from the middle of a window to its edge
C1, C2 = wp.constant(0.01**2), wp.constant(0.03**2)


@wp.struct
class Planes:
    """Three pictures [V,H,W] of vec3."""

    one: wp.array3d[wp.vec3]
    two: wp.array3d[wp.vec3]
    three: wp.array3d[wp.vec3]


@wp.struct
class Filmed:
    """Of every camera: what it filmed [C,H,W], that and its square blurred, and the weights of absolute errors."""

    target: wp.array3d[wp.vec3]
    mean: wp.array3d[wp.vec3]
    square: wp.array3d[wp.vec3]
    weight: wp.array3d[float]


@wp.struct
class Triple:
    """Three colours."""

    one: wp.vec3
    two: wp.vec3
    three: wp.vec3


@wp.func
def is_near(dirty: wp.array2d[int], c: int, x: int, y: int, across: int, down: int, grid: TileGrid) -> bool:
    """Whether a dirty tile begins within so many pixels; fewer than a tile, so that the corners tell."""
    left = wp.max(x - across, 0) // TILE_X
    right = wp.min(x + across, grid.width - 1) // TILE_X
    top = wp.max(y - down, 0) // TILE_Y * grid.tiles_x
    bottom = wp.min(y + down, grid.height - 1) // TILE_Y * grid.tiles_x
    found = dirty[c, top + left] + dirty[c, top + right] + dirty[c, bottom + left] + dirty[c, bottom + right]
    return found > 0


@wp.func
def down_column(planes: Planes, window: wp.array[float], v: int, y: int, x: int, height: int) -> Triple:
    """Three planes through the window along a column; nothing lies outside of the picture."""
    sums = Triple()
    for k in range(11):
        row = y + k - REACH
        if row >= 0 and row < height:
            sums.one += planes.one[v, row, x] * window[k]
            sums.two += planes.two[v, row, x] * window[k]
            sums.three += planes.three[v, row, x] * window[k]
    return sums


@wp.func
def sign(x: float) -> float:
    """-1, 0 or 1."""
    return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0))


@wp.kernel(enable_backward=False, grid_stride=False)
def blur_moments(
    image: wp.array3d[wp.vec3],
    filmed: Filmed,
    chosen: wp.array[int],
    dirty: wp.array2d[int],
    grid: TileGrid,
    window: wp.array[float],
    lines: Planes,
) -> None:
    """Grid (V, H, W): the image, its square and its product with the target, through the window along lines."""
    v, y, x = wp.tid()
    c = chosen[v]
    if not is_near(dirty, c, x, y, REACH, 2 * REACH, grid):
        return
    sums = Triple()
    for k in range(11):
        column = x + k - REACH
        if column >= 0 and column < grid.width:
            a = image[v, y, column]
            sums.one += a * window[k]
            sums.two += wp.cw_mul(a, a) * window[k]
            sums.three += wp.cw_mul(a, filmed.target[c, y, column]) * window[k]
    lines.one[v, y, x] = sums.one
    lines.two[v, y, x] = sums.two
    lines.three[v, y, x] = sums.three


@wp.kernel(enable_backward=False, grid_stride=False)
def compare(
    image: wp.array3d[wp.vec3],
    filmed: Filmed,
    chosen: wp.array[int],
    dirty: wp.array2d[int],
    grid: TileGrid,
    window: wp.array[float],
    lines: Planes,
    told: wp.array[float],
    slopes: Planes,
    totals: wp.array[float],
) -> None:
    """SSIM (Wang et al. 2004, equation 13), its derivatives by the moments, and the loss.

    Grid (V, H, W rounded up to whole warps): a lane that is not there has no number to add.

    Args:
        slopes: out, by the blurred image, its blurred square and the blurred product.
        totals: in and out, the loss of the pictures, the mean over the views.
    """
    v, y, x = wp.tid()
    c = chosen[v]
    share = told[DSSIM_WEIGHT]
    lost = float(0.0)
    near = bool(False)
    if x < grid.width:
        near = is_near(dirty, c, x, y, REACH, REACH, grid)
    if near:
        sums = down_column(lines, window, v, y, x, grid.height)
        mean = filmed.mean[c, y, x]
        square = filmed.square[c, y, x]
        by_mean = wp.vec3()
        by_square = wp.vec3()
        by_product = wp.vec3()
        for channel in range(3):
            a = sums.one[channel]
            b = mean[channel]
            luminance = 2.0 * a * b + C1
            likeness = 2.0 * (sums.three[channel] - a * b) + C2
            means = a * a + b * b + C1
            variances = sums.two[channel] - a * a + square[channel] - b * b + C2
            inverse = 1.0 / (means * variances)
            ssim = luminance * likeness * inverse
            by_mean[channel] = 2.0 * (b * (likeness - luminance) * inverse + ssim * a * (1.0 / variances - 1.0 / means))
            by_square[channel] = -ssim / variances
            by_product[channel] = 2.0 * luminance * inverse
            lost += share * (1.0 - ssim)
        slopes.one[v, y, x] = by_mean
        slopes.two[v, y, x] = by_square
        slopes.three[v, y, x] = by_product
        if is_near(dirty, c, x, y, 0, 0, grid):
            difference = image[v, y, x] - filmed.target[c, y, x]
            absolute = wp.abs(difference[0]) + wp.abs(difference[1]) + wp.abs(difference[2])
            lost += (1.0 - share) * filmed.weight[c, y, x] * absolute
    lost = lanes_sum(lost)
    if is_first_lane():
        wp.atomic_add(totals, SUM_LOSS, lost / (3.0 * float(image.shape[0] * grid.width * grid.height)))


@wp.kernel(enable_backward=False, grid_stride=False)
def blur_slopes(
    slopes: Planes,
    chosen: wp.array[int],
    dirty: wp.array2d[int],
    grid: TileGrid,
    window: wp.array[float],
    lines: Planes,
) -> None:
    """Grid (V, H, W): the derivatives through the window along lines."""
    v, y, x = wp.tid()
    if not is_near(dirty, chosen[v], x, y, 0, REACH, grid):
        return
    sums = Triple()
    for k in range(11):
        column = x + k - REACH
        if column >= 0 and column < grid.width:
            sums.one += slopes.one[v, y, column] * window[k]
            sums.two += slopes.two[v, y, column] * window[k]
            sums.three += slopes.three[v, y, column] * window[k]
    lines.one[v, y, x] = sums.one
    lines.two[v, y, x] = sums.two
    lines.three[v, y, x] = sums.three


@wp.kernel(enable_backward=False, grid_stride=False)
def differentiate_loss(
    image: wp.array3d[wp.vec3],
    filmed: Filmed,
    chosen: wp.array[int],
    dirty: wp.array2d[int],
    grid: TileGrid,
    window: wp.array[float],
    lines: Planes,
    told: wp.array[float],
    by_image: wp.array3d[wp.vec3],
) -> None:
    """Grid (V, H, W): the gradient by the pixels of dirty tiles, zero elsewhere."""
    v, y, x = wp.tid()
    c = chosen[v]
    slope = wp.vec3(0.0, 0.0, 0.0)
    if is_near(dirty, c, x, y, 0, 0, grid):
        sums = down_column(lines, window, v, y, x, grid.height)
        a = image[v, y, x]
        b = filmed.target[c, y, x]
        similar = sums.one + wp.cw_mul(a, sums.two) * 2.0 + wp.cw_mul(b, sums.three)
        away = wp.vec3(sign(a[0] - b[0]), sign(a[1] - b[1]), sign(a[2] - b[2]))
        share = told[DSSIM_WEIGHT]
        slope = away * ((1.0 - share) * filmed.weight[c, y, x]) - similar * share
        slope *= 1.0 / (3.0 * float(image.shape[0] * grid.width * grid.height))
    by_image[v, y, x] = slope
