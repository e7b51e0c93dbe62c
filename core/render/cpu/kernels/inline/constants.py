"""Numbers that all kernels agree on: the rules of the image model, tile size, array layouts, compiler options."""

from __future__ import annotations

from typing import Any

import numpy as np

from streamlod.core.render import tiles

# The image model, gsplat's rules but for LOW_PASS: every backend and the reference follow them.
ALPHA_MIN = np.float32(1 / 255)  # weaker contributions are skipped
ALPHA_MAX = np.float32(0.999)
OPACITY_MAX = np.float32(2)  # dropout may scale opacities up to this; stronger ones count as this
TRANSMITTANCE_MIN = np.float32(1e-4)  # a pixel is finished before it would fall to this
NEAR = np.float32(0.01)  # world units
FAR = np.float32(1e10)
# What cannot be linearised is left out: a Gaussian beyond both of the first two, and one beyond the third.
MAX_ASIDE = np.float32(1)  # from the picture's middle to the centre, in widths and heights of the picture
MAX_SLOPE = np.float32(1)  # tangent of the angle between the view's axis and the centre
MAX_SPREAD = np.float32(0.5)  # standard deviation along the view's axis, in depths of the centre
# More would draw Gaussians too wide in pictures smaller than those of the training, and too narrow in larger ones.
LOW_PASS = np.float32(0.1)  # pixels^2 added to both variances
FIELD_MARGIN = np.float32(0.3)  # Jacobian clamped beyond 1.3 times the half field of view
COLOUR_MAX = np.float32(1e15)  # larger sums of colours would overflow in gradients
FINITE = np.float32(1e30)  # sums beyond are taken as overflowed

LANES = 8
TILE_WIDTH, TILE_HEIGHT = tiles.TILE_WIDTH, tiles.TILE_HEIGHT
TILE_PIXELS = TILE_WIDTH * TILE_HEIGHT

# One projected Gaussian, 64 bytes: a cache line. The conic is scaled so that its quadratic form gives -sigma / 8.
RECORD = 16
MEAN_X, MEAN_Y, CONIC_A, CONIC_B, CONIC_C, OPACITY, CUT, RED, GREEN, BLUE = range(10)
EXTENT_X, EXTENT_Y, SKEW, INVERSE_A, REACH, DETERMINANT = range(10, 16)

# Sums over pixels per Gaussian: dL/dcolour, then moments of dL/dsigma about the mean.
SUMS = 9
SUM_RED, SUM_GREEN, SUM_BLUE, SUM_1, SUM_X, SUM_Y, SUM_XX, SUM_XY, SUM_YY = range(9)

# Camera as 16 floats: rotation row by row, translation, then fx fy cx cy.
FOCAL_X, FOCAL_Y, CENTRE_X, CENTRE_Y = range(12, 16)

ZERO, ONE, TWO, EIGHT = np.float32(0), np.float32(1), np.float32(2), np.float32(8)
HALF, EIGHTH = np.float32(0.5), np.float32(0.125)

# Fast mathematics but for the assumption that nothing is NaN or infinite: the culls depend on comparing those.
_FAST = {"contract", "reassoc", "nsz", "arcp"}
INLINE: dict[str, Any] = {"fastmath": _FAST, "error_model": "numpy", "boundscheck": False, "forceinline": True}
SERIAL: dict[str, Any] = {"fastmath": _FAST, "error_model": "numpy", "boundscheck": False, "nogil": True}
KERNEL: dict[str, Any] = {**SERIAL, "cache": True, "parallel": True}
