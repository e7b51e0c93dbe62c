"""The state of a list before Gaussians are listed again."""

from __future__ import annotations

import warp as wp

from streamlod.core.render.warp.kernels.rules import NO_KEY, Layer


@wp.kernel(enable_backward=False, grid_stride=False)
def clear_list(
    keys: wp.array[wp.uint64], layer: Layer, wanted: wp.array[wp.int64], most: wp.array[wp.int64], pairs: int
) -> None:
    """Grid: the larger of `pairs`, the capacity, and the number of ranges.

    Args:
        wanted: in and out, [1] back to zero. most: in and out, [1] the largest that `wanted` ever was.
    """
    p = wp.tid()
    if p < pairs:
        keys[p] = NO_KEY
    if p < layer.first.shape[0]:
        layer.first[p] = 0
        layer.last[p] = 0
    if p == 0:
        most[0] = wp.max(most[0], wanted[0])
        wanted[0] = wp.int64(0)
