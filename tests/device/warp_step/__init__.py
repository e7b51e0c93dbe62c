"""A training step of a later frame in NVIDIA Warp: recorded once, replayed for every step of every frame.

No command uses it yet: it waits here for its measurement on a GPU (`tests.bench.gpu_day`).
"""
