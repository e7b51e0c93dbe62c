"""The rasteriser in NVIDIA Warp: one source for CUDA and, slowly, for the CPU, where it is tested."""
