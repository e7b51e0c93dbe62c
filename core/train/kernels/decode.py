"""Kernels behind `core.train.field.decode`: from the network's outputs to Gaussians, and the derivative.

A row is an anchor; the network's outputs are opacity [K], colour [3K], relative scale [3K] and rotation [4K].
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.render.cpu.kernels.inline.constants import INLINE, KERNEL, ONE, TWO, ZERO
from streamlod.core.scene.gaussians import MAX_LOG_SCALE

_MAX_LOG_SCALE = np.float32(MAX_LOG_SCALE)
_LOWEST, _HIGHEST = np.float32(-87), np.float32(88)  # exponents whose exp is a normal float32
_LOG2E, _LN2_HIGH, _LN2_LOW = np.float32(1.44269504), np.float32(0.693359375), np.float32(-2.12194440e-4)
_TAYLOR = tuple(np.float32(1 / f) for f in (720, 120, 24, 6, 2))


@numba.njit(**INLINE)
def _exp(x: Any) -> Any:
    """exp without a call or a branch, so that loops over it vectorise; relative error 2e-7."""
    held = min(max(x, _LOWEST), _HIGHEST)
    power = np.rint(held * _LOG2E)
    rest = held - power * _LN2_HIGH - power * _LN2_LOW
    sum_ = _TAYLOR[0]
    sum_ = sum_ * rest + _TAYLOR[1]
    sum_ = sum_ * rest + _TAYLOR[2]
    sum_ = sum_ * rest + _TAYLOR[3]
    sum_ = sum_ * rest + _TAYLOR[4]
    sum_ = sum_ * rest + ONE
    sum_ = sum_ * rest + ONE
    result = sum_ * np.int32((np.int32(power) + np.int32(127)) << np.int32(23)).view(np.float32)
    return x if math.isnan(x) else result


@numba.njit(**INLINE)
def _sigmoid(x: Any) -> Any:
    """1 / (1 + exp(-x)), by `_exp`."""
    return ONE / (ONE + _exp(-x))


@numba.njit(**KERNEL)
def activate(
    workers: int,
    outputs: Float32,
    offset: Float32,
    scaling: Float32,
    position: Float32,
    size: Float32,
    means: Float32,
    quaternions: Float32,
    scales: Float32,
    opacities: Float32,
    colours: Float32,
) -> None:
    """Gaussians of n anchors, as `core.train.field.decode.decode` makes them of the network's outputs.

    Args:
        outputs: [n,11K]. offset: [n,3K]. scaling: [n,6]. position: [n,3].
        size: out, [n,6] exp of the scaling.
        means, scales, colours: out, [n,3K]. quaternions: out, [n,4K]. opacities: out, [n,K].
    """
    count, slots = opacities.shape
    for w in numba.prange(workers):
        for i in range(count * w // workers, count * (w + 1) // workers):
            for c in range(6):
                size[i, c] = _exp(min(max(scaling[i, c], -_MAX_LOG_SCALE), _MAX_LOG_SCALE))
            for k in range(slots):
                opacities[i, k] = TWO * _sigmoid(TWO * outputs[i, k]) - ONE
            for j in range(3 * slots):
                colours[i, j] = _sigmoid(outputs[i, slots + j])
            for j in range(3 * slots):
                scales[i, j] = _sigmoid(outputs[i, 4 * slots + j])
            for k in range(slots):
                for c in range(3):
                    means[i, 3 * k + c] = position[i, c] + offset[i, 3 * k + c] * size[i, c]
                    scales[i, 3 * k + c] *= size[i, 3 + c]
                for c in range(4):
                    quaternions[i, 4 * k + c] = outputs[i, 7 * slots + 4 * k + c]
                quaternions[i, 4 * k] += ONE


@numba.njit(**KERNEL)
def differentiate(
    workers: int,
    offset: Float32,
    scaling: Float32,
    size: Float32,
    scales: Float32,
    opacities: Float32,
    colours: Float32,
    by_means: Float32,
    by_quaternions: Float32,
    by_scales: Float32,
    by_opacities: Float32,
    by_colours: Float32,
    to_outputs: Float32,
    to_offset: Float32,
    to_scaling: Float32,
    to_position: Float32,
) -> None:
    """The derivative of `activate`.

    Args:
        offset, scaling: its arguments; size, scales, opacities, colours: its results.
        by_means, by_quaternions, by_scales, by_opacities, by_colours: derivatives of the loss by its results.
        to_outputs: out, [n,11K]. to_offset: out, [n,3K]. to_scaling: out, [n,6]. to_position: out, [n,3].
    """
    count, slots = opacities.shape
    for w in numba.prange(workers):
        for i in range(count * w // workers, count * (w + 1) // workers):
            for k in range(slots):
                to_outputs[i, k] = by_opacities[i, k] * (ONE - opacities[i, k] * opacities[i, k])
            for j in range(3 * slots):
                to_outputs[i, slots + j] = by_colours[i, j] * colours[i, j] * (ONE - colours[i, j])
            for j in range(4 * slots):
                to_outputs[i, 7 * slots + j] = by_quaternions[i, j]
            for c in range(3):
                moved, stretched, grown = ZERO, ZERO, ZERO
                for k in range(slots):
                    j = 3 * k + c
                    to_offset[i, j] = by_means[i, j] * size[i, c]
                    moved += by_means[i, j]
                    stretched += by_means[i, j] * offset[i, j]
                    widened = by_scales[i, j] * scales[i, j]
                    to_outputs[i, 4 * slots + j] = widened * (ONE - scales[i, j] / size[i, 3 + c])
                    grown += widened
                to_position[i, c] = moved
                to_scaling[i, c] = stretched * size[i, c] if abs(scaling[i, c]) <= _MAX_LOG_SCALE else ZERO
                to_scaling[i, 3 + c] = grown if abs(scaling[i, 3 + c]) <= _MAX_LOG_SCALE else ZERO
