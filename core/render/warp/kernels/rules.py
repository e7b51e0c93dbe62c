"""The image model's numbers, as `core.render.cpu.kernels.inline.constants` has them, and the layout of arrays."""

from __future__ import annotations

import warp as wp

from streamlod.core.render.cpu.kernels.inline import constants as rules
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH

ALPHA_MIN = wp.constant(float(rules.ALPHA_MIN))
ALPHA_MAX = wp.constant(float(rules.ALPHA_MAX))
OPACITY_MAX = wp.constant(float(rules.OPACITY_MAX))
TRANSMITTANCE_MIN = wp.constant(float(rules.TRANSMITTANCE_MIN))
NEAR, FAR = wp.constant(float(rules.NEAR)), wp.constant(float(rules.FAR))
MAX_ASIDE, MAX_SLOPE = wp.constant(float(rules.MAX_ASIDE)), wp.constant(float(rules.MAX_SLOPE))
MAX_SPREAD = wp.constant(float(rules.MAX_SPREAD))
LOW_PASS = wp.constant(float(rules.LOW_PASS))
FIELD_MARGIN = wp.constant(float(rules.FIELD_MARGIN))
COLOUR_MAX, FINITE = wp.constant(float(rules.COLOUR_MAX)), wp.constant(float(rules.FINITE))
MIN_DETERMINANT = wp.constant(1e-12)  # pixels^4; flatter ellipses cannot be inverted
TILE_X, TILE_Y = wp.constant(TILE_WIDTH), wp.constant(TILE_HEIGHT)
SLACK = wp.constant(1e-3)  # of a tile, against rounding where an ellipse touches a tile's edge
NO_KEY = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # behind all keys of a sorted list
NOWHERE = wp.constant(3.0e38)  # the depth of what follows the last Gaussian of a list

# A camera's row: rotation 9, translation 3, fx fy cx cy, then the exposure of its colours and what lies behind them.
FOCAL_X, FOCAL_Y, CENTRE_X, CENTRE_Y = (wp.constant(k) for k in range(12, 16))
GAIN, OFFSET, BACKGROUND = wp.constant(16), wp.constant(19), wp.constant(22)
CAMERA_NUMBERS = 25


@wp.struct
class TileGrid:
    """The pixels and tiles of every picture."""

    width: int
    height: int
    tiles_x: int
    tiles: int


@wp.struct
class Layer:
    """Projected Gaussians of some views, listed by tile and depth.

    Attributes:
        place: [V,G] mean x and y in pixels, opacity, sigma at which alpha is 1/255; an opacity of 0: not drawn.
        conic: [V,G] inverse covariance xx, xy, yy, and depth.
        colour: [V,G].
        first, last: [V*tiles] where a tile's list begins and ends in `ids`.
        ids: [2*pairs] numbers of Gaussians; its second half is the sorting's work memory.
    """

    place: wp.array2d[wp.vec4]
    conic: wp.array2d[wp.vec4]
    colour: wp.array2d[wp.vec3]
    first: wp.array[int]
    last: wp.array[int]
    ids: wp.array[int]


@wp.struct
class Cloud:
    """Gaussians as `core.scene.gaussians` has them, [D,G]: for each view its own (D = V), or one for all (D = 1)."""

    means: wp.array2d[wp.vec3]
    quaternions: wp.array2d[wp.vec4]
    scales: wp.array2d[wp.vec3]
    opacities: wp.array2d[float]
    colours: wp.array2d[wp.vec3]
