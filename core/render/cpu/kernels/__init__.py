"""Numba kernels of the CPU rasteriser: plain contiguous arrays in, arrays out, no Python objects.

One file a stage, because numba caches by file; what several stages share lies in `inline` and is compiled into each.
"""
