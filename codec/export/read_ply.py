"""PLY files of Gaussians, in the layout of the original 3D Gaussian splatting code, or compressed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from streamlod.codec.export import read_compressed_ply
from streamlod.codec.export.ply import SH_C0
from streamlod.core.errors import InputError
from streamlod.core.initialise.ply_tables import read_tables
from streamlod.core.scene.gaussians import GaussianCloud, as_cloud

_NAMES = (
    *("x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2"),
    *("opacity", "f_dc_0", "f_dc_1", "f_dc_2"),
)
_MAX_LOG = 20.0  # of scales, and of opacities


def decode_ply(path: Path) -> GaussianCloud:
    """The Gaussians of a file; colour of the view's direction is dropped, as are rows with a number that is not finite.

    Sizes of nothing and opacities of 0 and 1 have infinite logarithms, and are kept.

    Raises:
        InputError: the file cannot be read, is damaged, or is one of points or of another layout.
    """
    tables = read_tables(path)
    table = tables["vertex"]
    if read_compressed_ply.is_compressed(tables):
        return read_compressed_ply.unpacked(path, tables)
    missing = [name for name in _NAMES if name not in (table.dtype.names or ())]
    if missing:
        raise InputError(path, f"is no PLY of Gaussians: its vertices lack {', '.join(missing)}")
    with np.errstate(over="ignore"):
        columns = np.stack([table[name].astype(np.float32) for name in _NAMES], axis=1)
    columns[:, 7:11] = np.clip(columns[:, 7:11], -_MAX_LOG, _MAX_LOG)
    columns = columns[np.isfinite(columns).all(axis=1)]
    means, quaternions, scales, opacity, colours = np.split(columns, [3, 7, 10, 11], axis=1)
    opacities = 1 / (1 + np.exp(-opacity[:, 0]))
    return as_cloud(means, quaternions, np.exp(scales), opacities, np.clip(0.5 + SH_C0 * colours, 0, 1))
