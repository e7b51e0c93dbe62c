"""Synthetic scenes, filmed by a rig of cameras: pictures and exact ground truth.

A small ray caster of our own. One file of `kinds` is one place, put together from analytic shapes (`shapes`, `parts`)
and things that move (`movers`). Compiled `casting`, `lighting` and `textures` make pictures of it, a camera at a time
(`render`), offered as a data set or as files (`clip`).
"""

from streamlod.core.synthetic.clip import open_synthetic, read_spec, write_clip
from streamlod.core.synthetic.render import (
    GroundTruth,
    ground_truth,
    moving_surface,
    render_image,
    render_view,
    surface_motion,
)
from streamlod.core.synthetic.spec import SyntheticSpec, cameras

__all__ = [
    "GroundTruth",
    "SyntheticSpec",
    "cameras",
    "ground_truth",
    "moving_surface",
    "open_synthetic",
    "read_spec",
    "render_image",
    "render_view",
    "surface_motion",
    "write_clip",
]
