"""Differences of two rigs after the rigid motion that fits one best to the other."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid


def differences(found: Float64, truth: Float64) -> tuple[Float64, Float64]:
    """[C] degrees and [C] metres between cameras [C,6] (world to camera), after rotations and centres are aligned."""
    turn = (Rotation.from_rotvec(found[:, :3]).inv() * Rotation.from_rotvec(truth[:, :3])).mean()  # truth -> found
    here, there = rigid.inverse(found)[:, 3:], rigid.inverse(truth)[:, 3:]
    moved = turn.apply(there - there.mean(axis=0)) + here.mean(axis=0)
    turned = (Rotation.from_rotvec(truth[:, :3]) * turn.inv()).as_rotvec()
    away = rigid.angles(found, np.concatenate([turned, np.zeros_like(turned)], axis=1))
    return away, np.asarray(np.linalg.norm(here - moved, axis=1), np.float64)
