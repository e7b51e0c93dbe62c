"""L1 + D-SSIM with its gradient, on numpy arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.render.cpu.kernels.photometric import photometric
from streamlod.core.render.tiles import Box

_CHANNELS = 3


def photometric_sums(
    image: Float32, target: Float32, dssim_weight: float, boxes: Sequence[Box], pixel_weights: Float32 | None = None
) -> tuple[float, Float32]:
    """The loss of `core.train.loss.photometric.photometric_loss` and its gradient [H,W,3] by `image`.

    Args:
        image, target: [H,W,3], C-contiguous. boxes: parts to look at, ten pixels apart.
        pixel_weights: [H,W,3], C-contiguous, weights of the absolute differences; None for ones.
    """
    flat, unit = (image.shape[0], image.shape[1] * _CHANNELS), 1 / image.size
    weights = (np.float32((1 - dssim_weight) * unit), np.float32(dssim_weight * unit))
    gradient, totals = np.zeros(image.shape, np.float32), np.zeros(2)
    pixel_weights = np.ones(image.shape, np.float32) if pixel_weights is None else pixel_weights
    pictures = image.reshape(flat), target.reshape(flat), pixel_weights.reshape(flat)
    for left, top, right, bottom in boxes:
        workers = min(numba.get_num_threads(), bottom - top)
        sums, span = np.zeros((workers, 2)), (left * _CHANNELS, right * _CHANNELS, top, bottom)
        photometric(workers, *pictures, *span, weights, gradient.reshape(flat), sums)
        totals += sums.sum(axis=0)
    l1, dissimilarity = totals
    return float(((1 - dssim_weight) * l1 + dssim_weight * dissimilarity) * unit), gradient
