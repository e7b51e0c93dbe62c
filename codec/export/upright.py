"""Turning Gaussians so that the axis which points up in a file points up in a scene, which is -y."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.scene.gaussians import GaussianCloud

# w x y z, of any length, by the axis of the file that points up: turns about x as far as that does
_TURNS = {
    "-y": (1, 0, 0, 0), "y": (0, 1, 0, 0), "z": (1, 1, 0, 0), "-z": (1, -1, 0, 0), "x": (1, 0, 0, -1),
    "-x": (1, 0, 0, 1),
}  # fmt: skip


def turned(cloud: GaussianCloud, was: str, up: str) -> GaussianCloud:
    """The Gaussians with another axis of their file up.

    Args:
        was: the axis that was taken for up when the file was read. up: the one that is. Both of `snapshots.AXES`.
    """
    if was == up:
        return cloud
    w, x, y, z = _TURNS[was]
    turn = _product(np.array(_TURNS[up], np.float64), np.array([[w, -x, -y, -z]], np.float64))[0]
    turn /= np.linalg.norm(turn)
    means = cloud.means.astype(np.float64)
    places = np.concatenate([np.zeros((len(cloud), 1)), means], axis=1)
    there = _product(turn, _product(places, turn * np.array([1, -1, -1, -1])))[:, 1:]
    quaternions = _product(turn, cloud.quaternions.astype(np.float64))
    parts = (there.astype(np.float32), quaternions.astype(np.float32))
    return GaussianCloud(*parts, cloud.scales, cloud.opacities, cloud.colours)


def _product(a: Float64, b: Float64) -> Float64:
    """[N,4] products of quaternions w x y z, one of which may be a single one, [4]."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    product = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return np.stack(product, axis=-1)
