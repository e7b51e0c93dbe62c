"""Differences of two rigs after the rigid motion that fits one best to the other."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid


def aligned(found: Float64, truth: Float64) -> Float64:
    """[C,6] cameras `found` (world to camera) in the world of `truth` [C,6]: rotations and centres fit on average."""
    turn = (Rotation.from_rotvec(found[:, :3]).inv() * Rotation.from_rotvec(truth[:, :3])).mean()  # truth -> found
    here, there = (rigid.inverse(each)[:, 3:].mean(axis=0) for each in (found, truth))
    return rigid.after(found, np.concatenate([turn.as_rotvec(), here - turn.apply(there)]))


def differences(found: Float64, truth: Float64) -> tuple[Float64, Float64]:
    """[C] degrees and [C] metres between cameras [C,6] (world to camera), after rotations and centres are aligned."""
    moved = aligned(found, truth)
    away = rigid.inverse(moved)[:, 3:] - rigid.inverse(truth)[:, 3:]
    return rigid.angles(moved, truth), np.asarray(np.linalg.norm(away, axis=1), np.float64)
