"""Kernels of a training step in Warp."""
