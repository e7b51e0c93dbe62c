"""A scene looks the same in small pictures and in large ones, whatever size it was trained at."""

from __future__ import annotations

import math

import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.camera import pinhole
from streamlod.core.render.cpu import render
from streamlod.core.scene.gaussians import GaussianCloud

_DEPTH, _COUNT = 2.0, 48  # of a sheet of Gaussians, as many a side


def sheet() -> GaussianCloud:
    """A sheet across the view, one Gaussian a pixel of 48x48, in squares of four by four of a colour."""
    g = np.random.default_rng(0)
    row, column = np.mgrid[:_COUNT, :_COUNT].reshape(2, -1)
    pixel = _DEPTH / _COUNT
    means = np.stack([(column + 0.5) * pixel - 1, (row + 0.5) * pixel - 1, np.full(row.shape, _DEPTH)], axis=1)
    scales = np.broadcast_to([0.5 * pixel, 0.5 * pixel, 0.05 * pixel], means.shape)
    colours = g.uniform(size=(_COUNT // 4, _COUNT // 4, 3))[row // 4, column // 4]
    upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(means), 4))
    values = means, upright, scales, np.full(len(means), 0.9), colours
    return GaussianCloud(*(np.ascontiguousarray(value, np.float32) for value in values))


def drawn(width: int) -> Float32:
    """[W,W,3] the sheet, which fills the picture."""
    camera = pinhole("size", (width, width), (width / 2, width / 2), (width, width), np.eye(4))
    return render(sheet(), camera, np.zeros(3, np.float32)).image


def test_a_picture_of_half_the_size_shows_the_means_of_four_pixels() -> None:
    """Gaussians that were widened by much of a pixel would hide each other: 17 dB with a low-pass of 0.3."""
    four = drawn(_COUNT).reshape(_COUNT // 2, 2, _COUNT // 2, 2, 3).mean(axis=(1, 3))
    error = float(np.square(drawn(_COUNT // 2) - four).mean())
    assert -10 * math.log10(error) > 26
