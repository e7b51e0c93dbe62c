"""Work that the 32 lanes of a GPU's warp do together. On the CPU a kernel has one lane, and these are no work.

A kernel that uses them is launched for whole warps: what a lane gets from one that is not there is undefined.
"""

from __future__ import annotations

import warp as wp

LANES = 32


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int k = 16; k > 0; k >>= 1) value += __shfl_down_sync(0xffffffffu, value, k);
#endif
    return value;
""")
def lanes_sum(value: float) -> float:  # type: ignore[empty-body]
    """Sum over the lanes, in the first lane. All lanes must come here together."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return (threadIdx.x & 31) == 0;
#else
    return true;
#endif
""")
def is_first_lane() -> bool:  # type: ignore[empty-body]
    """Whether this is the lane that holds sums."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, flag);
#else
    return flag;
#endif
""")
def any_lane(flag: bool) -> bool:  # type: ignore[empty-body]
    """Whether the flag is set in any lane. All lanes must come here together."""
