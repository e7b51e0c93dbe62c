"""Snapshots for other programs: one instant as plain 3D Gaussians, in files that splat viewers and editors read.

bake.py   anchors to Gaussians, with colours seen from a camera or averaged over the rig
ply.py    the layout of the original 3D Gaussian splatting code
spz.py    the compressed format SPZ, version 3
"""

from streamlod.codec.export.bake import bake
from streamlod.codec.export.files import FORMATS, write_snapshot
from streamlod.codec.export.ply import encode_ply
from streamlod.codec.export.spz import encode_spz

__all__ = ["FORMATS", "bake", "encode_ply", "encode_spz", "write_snapshot"]
