"""Anchors as tensors: decoding to Gaussians, rounding, and conversion to and from integers."""
