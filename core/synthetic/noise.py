"""Building blocks of procedural textures: noise, softened edges, mixtures of colours."""

from __future__ import annotations

import math

import numba
import numpy as np

Colour = tuple[float, float, float]
_jit = numba.njit(cache=True, nogil=True, fastmath=True)


@_jit
def scatter(x: float, y: float, seed: int) -> float:
    """A fixed pseudo-random number in [0, 1) for a lattice point."""
    h = np.uint32(np.int64(x) * 374761393 + np.int64(y) * 668265263 + np.int64(seed) * 974634777)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(1274126177))
    h = np.uint32((h ^ (h >> np.uint32(16))) * np.uint32(2246822519))
    return np.float64(h ^ (h >> np.uint32(15))) / 4294967296.0


@_jit
def noise(x: float, y: float, seed: int) -> float:
    """Smooth value noise in [0, 1] with unit cells."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    low = scatter(i, j, seed) * (1.0 - u) + scatter(i + 1, j, seed) * u
    high = scatter(i, j + 1, seed) * (1.0 - u) + scatter(i + 1, j + 1, seed) * u
    return low * (1.0 - v) + high * v


@_jit
def fbm(x: float, y: float, footprint: float, seed: int) -> float:
    """Five octaves of noise round 0 in about [-1, 1]; octaves finer than `footprint` (in cells) fade out."""
    total, strength, scale = 0.0, 0.55, 1.0
    for octave in range(5):
        fade = min(max(1.0 / (scale * max(footprint, 1e-6)) - 1.0, 0.0), 1.0)
        if fade <= 0.0:
            break
        total += fade * strength * (2.0 * noise(x * scale, y * scale, seed + 31 * octave) - 1.0)
        strength, scale = 0.6 * strength, 2.03 * scale
    return total


@_jit
def step(edge: float, x: float, footprint: float) -> float:
    """0 below `edge`, 1 above, softened over a footprint."""
    t = min(max((x - edge) / max(footprint, 1e-6) + 0.5, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@_jit
def line(x: float, half: float, footprint: float) -> float:
    """1 where |x| < half, softened over a footprint, keeping its area."""
    width = max(half, 0.5 * footprint)
    return (half / width) * (1.0 - step(width, abs(x), footprint))


@_jit
def mix(a: Colour, b: Colour, t: float) -> Colour:
    """Linear mixture: `a` at t = 0, `b` at 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@_jit
def scale(a: Colour, t: float) -> Colour:
    """`a` times t."""
    return a[0] * t, a[1] * t, a[2] * t


@_jit
def hue(h: float) -> Colour:
    """A warm, muted colour for a hue in [0, 1]."""
    return (
        0.55 + 0.27 * math.cos(6.2832 * h),
        0.51 + 0.23 * math.cos(6.2832 * (h - 0.36)),
        0.48 + 0.25 * math.cos(6.2832 * (h - 0.67)),
    )
