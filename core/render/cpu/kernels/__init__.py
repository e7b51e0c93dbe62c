"""Numba kernels of the CPU rasteriser: plain contiguous arrays in, arrays out, no Python objects.

One file for each stage, because numba caches by file; code shared by stages is in `inline` and compiled into each.
"""
