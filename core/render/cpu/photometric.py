"""L1 + D-SSIM with its gradient, on numpy arrays."""

from __future__ import annotations

import numba
import numpy as np

from core.arrays import Float32
from core.render.cpu.kernels.photometric import photometric

_CHANNELS = 3


def photometric_sums(
    image: Float32, target: Float32, dssim_weight: float, box: tuple[int, int, int, int]
) -> tuple[float, Float32]:
    """The loss of `core.train.losses.photometric_loss` and its gradient [H,W,3] by `image`.

    Args:
        image, target: [H,W,3], C-contiguous. box: left, top, right, bottom in pixels.
    """
    height, width = image.shape[:2]
    left, top, right, bottom = box
    workers, unit = min(numba.get_num_threads(), bottom - top), 1 / image.size
    weights = (np.float32((1 - dssim_weight) * unit), np.float32(dssim_weight * unit))
    gradient, sums = np.zeros(image.shape, np.float32), np.zeros((workers, 2))
    flat = (height, width * _CHANNELS)
    span = (left * _CHANNELS, right * _CHANNELS, top, bottom)
    photometric(workers, image.reshape(flat), target.reshape(flat), *span, weights, gradient.reshape(flat), sums)
    l1, dissimilarity = sums.sum(axis=0)
    return float(((1 - dssim_weight) * l1 + dssim_weight * dissimilarity) * unit), gradient
