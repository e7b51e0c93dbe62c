"""PSNR and SSIM of a picture against the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from streamlod.core.arrays import Float32, Float64, UInt8

MAX_PSNR = 100.0  # dB: equal pictures would have infinity, which no mean and no JSON file can hold
Distance = Callable[[UInt8, UInt8], float]  # of a picture to the truth, such as LPIPS
WINDOW = 11
SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2  # for values in [0, 1]


def psnr(picture: UInt8 | Float32, truth: UInt8 | Float32) -> float:
    """Peak signal to noise ratio in dB over all pixels and channels, at most `MAX_PSNR`.

    Args:
        picture, truth: [H,W,3], uint8 or floats in [0, 1].

    Raises:
        ValueError: different shapes, or numbers that are not finite.
    """
    a, b = unit_pair(picture, truth)
    error = float(np.mean((a - b) ** 2))
    return min(MAX_PSNR, -10 * math.log10(max(error, 1e-30)))


def ssim(picture: UInt8 | Float32, truth: UInt8 | Float32) -> float:
    """Structural similarity (Wang et al. 2004, doi:10.1109/TIP.2003.819861), mean over pixels and channels.

    Gaussian window of 11x11 with sigma 1.5; outside the picture lie zeros, as in the evaluation of 3D Gaussian
    Splatting and of the work that follows it, so that values can be compared.

    Args:
        picture, truth: [H,W,3], uint8 or floats in [0, 1].

    Raises:
        ValueError: different shapes, or numbers that are not finite.
    """
    return float(np.mean(ssim_map(picture, truth)))


def ssim_map(picture: UInt8 | Float32, truth: UInt8 | Float32) -> Float64:
    """[H,W,3] what `ssim` is the mean of; arguments as there."""
    a, b = unit_pair(picture, truth)
    mean_a, mean_b = _blur(a), _blur(b)
    variance_a = _blur(a * a) - mean_a * mean_a
    variance_b = _blur(b * b) - mean_b * mean_b
    covariance = _blur(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + _C1) / (mean_a * mean_a + mean_b * mean_b + _C1)
    structure = (2 * covariance + _C2) / (variance_a + variance_b + _C2)
    return np.asarray(luminance * structure, np.float64)


def unit_pair(picture: UInt8 | Float32, truth: UInt8 | Float32) -> tuple[Float64, Float64]:
    """Both [H,W,3] pictures as float64 in [0, 1]; values outside are clipped, as a screen would.

    Raises:
        ValueError: different shapes, or numbers that are not finite.
    """
    if picture.shape != truth.shape or picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
        raise ValueError(f"pictures must be two arrays of one shape HxWx3, not {picture.shape} and {truth.shape}")
    return _unit(picture), _unit(truth)


def _unit(picture: UInt8 | Float32) -> Float64:
    values = picture.astype(np.float64)
    if picture.dtype == np.uint8:
        return values / 255
    if not np.isfinite(values).all():
        raise ValueError("the picture holds numbers that are not finite")
    return np.clip(values, 0, 1)


def _blur(values: Float64) -> Float64:
    kernel: Any = cv2.getGaussianKernel(WINDOW, SIGMA)
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_CONSTANT), np.float64)
