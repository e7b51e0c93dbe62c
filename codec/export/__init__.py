"""Snapshots for other programs: one instant as plain 3D Gaussians, in files that splat viewers and editors read.

`codec.snapshots` is the table of formats. A format that can be read has its reader beside it, `read_<name>.py`.

bake.py   anchors to Gaussians, with colours seen from a camera or averaged over the rig
ply.py    the layout of the original 3D Gaussian splatting code
spz.py    the compressed format SPZ, version 3
upright.py   Gaussians whose files have another axis up
"""

from streamlod.codec.export.bake import bake
from streamlod.codec.export.files import write_snapshot
from streamlod.codec.export.ply import encode_ply
from streamlod.codec.export.spz import encode_spz

__all__ = ["bake", "encode_ply", "encode_spz", "write_snapshot"]
