"""The rasteriser in NVIDIA Warp: one source for CUDA and, slowly, for the CPU, where it is tested."""

import warp as wp

wp.config.log_level = wp.LOG_WARNING  # it writes to standard output which kernels it loads


def finds_gpu() -> bool:
    """Whether there is a GPU, with a driver that is new enough for Warp's own CUDA."""
    return bool(wp.is_cuda_available())
