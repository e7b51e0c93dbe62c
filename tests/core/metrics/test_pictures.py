"""PSNR and SSIM, against direct computations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.arrays import Float64
from streamlod.core.metrics import MAX_PSNR, psnr, ssim


def _pair(seed: int = 0, shape: tuple[int, int, int] = (19, 23, 3)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0, 1, shape).astype(np.float32)
    return np.clip(truth + rng.normal(0, 0.1, shape), 0, 1).astype(np.float32), truth


def _ssim_by_definition(a: Float64, b: Float64) -> float:
    """Pixel by pixel: weighted moments in an 11x11 window with zeros outside."""
    offsets = np.arange(-5, 6)
    weights = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    weights = weights / weights.sum()
    height, width, channels = a.shape
    total = 0.0
    for c in range(channels):
        pa, pb = np.pad(a[..., c], 5), np.pad(b[..., c], 5)
        for y in range(height):
            for x in range(width):
                wa, wb = pa[y : y + 11, x : x + 11], pb[y : y + 11, x : x + 11]
                ma, mb = (weights * wa).sum(), (weights * wb).sum()
                va, vb = (weights * (wa - ma) ** 2).sum(), (weights * (wb - mb) ** 2).sum()
                cov = (weights * (wa - ma) * (wb - mb)).sum()
                total += ((2 * ma * mb + 1e-4) * (2 * cov + 9e-4)) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    return float(total / (height * width * channels))


def test_ssim_is_its_definition() -> None:
    a, b = _pair()
    assert ssim(a, b) == pytest.approx(_ssim_by_definition(a.astype(np.float64), b.astype(np.float64)), abs=1e-6)


def test_ssim_of_a_flat_difference_by_hand() -> None:
    # far from the border, where zeros lie outside, only the luminance term is left
    a, b = np.full((600, 600, 3), 0.2, np.float32), np.full((600, 600, 3), 0.4, np.float32)
    inner = (2 * 0.2 * 0.4 + 1e-4) / (0.2**2 + 0.4**2 + 1e-4)
    assert ssim(a, b) == pytest.approx(inner, abs=0.005)


def test_psnr_by_hand() -> None:
    truth = np.full((8, 8, 3), 100, np.uint8)
    assert psnr(truth + np.uint8(5), truth) == pytest.approx(20 * math.log10(255 / 5))
    assert psnr(truth, truth) == MAX_PSNR
    half = np.zeros((2, 2, 3), np.float32)
    assert psnr(half + np.float32(0.5), half) == pytest.approx(10 * math.log10(4), abs=1e-6)


def test_bytes_and_floats_are_the_same_picture() -> None:
    a, b = (np.round(image * 255).astype(np.uint8) for image in _pair())
    as_floats = [(image / 255).astype(np.float32) for image in (a, b)]
    assert psnr(a, b) == pytest.approx(psnr(*as_floats), abs=1e-4)
    assert ssim(a, b) == pytest.approx(ssim(*as_floats), abs=1e-6)
    assert psnr(a, as_floats[1]) == pytest.approx(psnr(a, b), abs=1e-4)


@settings(deadline=None)
@given(seed=st.integers(0, 1000))
def test_both_are_symmetric_and_best_for_equal_pictures(seed: int) -> None:
    a, b = _pair(seed)
    assert ssim(a, b) == pytest.approx(ssim(b, a), abs=1e-12)
    assert psnr(a, b) == pytest.approx(psnr(b, a), abs=1e-9)
    assert ssim(b, b) == pytest.approx(1, abs=1e-12)
    assert -1 <= ssim(a, b) < 1


def test_values_outside_the_range_of_a_screen_are_clipped() -> None:
    a, b = _pair()
    assert psnr(np.where(b == b.max(), 7, b).astype(np.float32), b) > 20
    assert psnr(a * 0 - 3, b * 0) == MAX_PSNR


@pytest.mark.parametrize("measure", [psnr, ssim])
def test_pictures_that_cannot_be_compared(measure) -> None:  # type: ignore[no-untyped-def]
    a, b = _pair()
    with pytest.raises(ValueError, match="one shape"):
        measure(a[:5], b)
    with pytest.raises(ValueError, match="one shape"):
        measure(a[..., 0], b[..., 0])
    with pytest.raises(ValueError, match="one shape"):
        measure(a[:0], b[:0])
    a[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        measure(a, b)
