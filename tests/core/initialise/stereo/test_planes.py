"""Planes of a view in pictures of other sizes."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.arrays import Float64
from streamlod.core.initialise.stereo.planes import facing, resampled

LIMITS = (0.1, 2.0)


def one_plane(width: int, height: int) -> Float64:
    """[H,W,3] the plane 0.5 + 0.3 u - 0.2 v, where u and v run from 0 to 1 across the picture."""
    u, v = ((np.arange(n) + 0.5) / n for n in (width, height))
    depth = 0.5 + 0.3 * u[None] - 0.2 * v[:, None]
    return np.stack([depth, np.full_like(depth, 0.3 / width), np.full_like(depth, -0.2 / height)], axis=2)


@pytest.mark.parametrize("size", [(64, 48), (63, 47), (16, 12), (7, 5), (1, 1)])
def test_a_plane_is_the_same_plane_in_any_size(size: tuple[int, int]) -> None:
    np.testing.assert_allclose(resampled(one_plane(32, 24), size, LIMITS), one_plane(*size), atol=1e-12)


def test_inverse_depths_stay_within_their_limits() -> None:
    steep = one_plane(4, 4) * [[[1.0, 20.0, 1.0]]]
    assert resampled(steep, (32, 32), LIMITS)[..., 0].min() == LIMITS[0]
    assert facing(np.array([[0.01, 1.0, 100.0]], np.float32), LIMITS)[..., 0].tolist() == [[2.0, 1.0, 0.1]]
