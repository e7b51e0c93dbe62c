"""Synthetic scenes, filmed by a rig of cameras: pictures and exact ground truth.

A small ray caster of our own. One file of `kinds` is one place, put together from analytic shapes (`shapes`, `parts`)
and things that move (`movers`). Compiled `casting`, `lighting` and `textures` make pictures of it, a camera at a time
(`render`), offered as a data set or as files (`clip`).
"""

from core.synthetic.clip import open_synthetic, write_clip
from core.synthetic.render import GroundTruth, is_dynamic, render_frame, render_image, surface_motion
from core.synthetic.spec import SyntheticSpec, cameras

__all__ = [
    "GroundTruth",
    "SyntheticSpec",
    "cameras",
    "is_dynamic",
    "open_synthetic",
    "render_frame",
    "render_image",
    "surface_motion",
    "write_clip",
]
