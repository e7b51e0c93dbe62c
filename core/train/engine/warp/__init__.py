"""A training step of a later frame in NVIDIA Warp: recorded once, replayed for every step of every frame."""
