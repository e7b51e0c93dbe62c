"""Compile the trainer's kernels ahead of their first use."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.scene.entropy_model import BINS
from streamlod.core.train.kernels.adam import adam_step
from streamlod.core.train.kernels.decode import activate, differentiate
from streamlod.core.train.kernels.rate import residual_bits
from streamlod.core.train.kernels.windows import best_depths


def warm() -> None:
    """Compile every kernel, or load it from the cache: some seconds once."""

    def zeros(*shape: int) -> Float32:
        return np.zeros(shape, np.float32)

    numbers = tuple(np.float32(number) for number in (0.1, 1.0, 0.1, 0.001, 1e-15))
    adam_step(1, zeros(1), zeros(1), zeros(1), zeros(1), numbers, np.zeros(1, np.int64))
    sums = np.zeros((1, 3))
    residual_bits(sums, zeros(1, 2), zeros(1, 1), zeros(BINS, 3), 0.5, np.float32(4), zeros(1, 2), zeros(1, 1))
    parts = [zeros(1, width) for width in (3, 4, 3, 1, 3)]
    activate(1, zeros(1, 11), zeros(1, 3), zeros(1, 6), zeros(1, 3), zeros(1, 6), *parts)
    known = (zeros(1, 3), zeros(1, 6), zeros(1, 6), *parts[2:])
    differentiate(1, *known, *parts, zeros(1, 11), zeros(1, 3), zeros(1, 6), zeros(1, 3))
    pixel, ends = np.zeros(1, np.int64), np.linspace(0.5, 1.0, 2)
    poses = (np.eye(3)[None], np.zeros((1, 3)))
    best_depths(1, zeros(1, 1, 3), zeros(1, 1, 1, 3), *poses, ends, pixel, pixel, pixel.copy(), zeros(1))
