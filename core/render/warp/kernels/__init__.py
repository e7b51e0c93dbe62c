"""Kernels of the rasteriser in Warp."""
