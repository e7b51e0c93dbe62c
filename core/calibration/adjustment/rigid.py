"""Rigid transforms as [...,6]: a rotation vector and a translation, x' = exp(rotation) x + translation.

Rows that hold NaN are not known, and give NaN.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from streamlod.core.arrays import Bool, Float64

IDENTITY = np.zeros(6)
_SMALL = 1e-6
_BLOCK = 256  # poses that are compared with all at once


def rotations(vectors: Float64) -> Float64:
    """[N,3,3] matrices of rotation vectors [N,3]."""
    return np.asarray(Rotation.from_rotvec(np.reshape(vectors, (-1, 3))).as_matrix(), np.float64)


def matrix(pose: Float64) -> Float64:
    """[4,4] of one transform [6]."""
    full = np.eye(4)
    full[:3, :3], full[:3, 3] = rotations(pose[:3])[0], pose[3:]
    return full


def pose(full: Float64) -> Float64:
    """[6] of one matrix [4,4]."""
    return np.concatenate([Rotation.from_matrix(full[:3, :3]).as_rotvec(), full[:3, 3]])


def after(second: Float64, first: Float64) -> Float64:
    """[N,6] transforms that apply `first` [N,6], then `second` [N,6]; either may be one [6]."""
    first, second = _of_one_length(first, second)
    turned = _rotation(second)
    vectors = (turned * _rotation(first)).as_rotvec()
    found = np.concatenate([vectors, turned.apply(first[:, 3:]) + second[:, 3:]], axis=1)
    return np.where(_known(first) & _known(second), found, np.nan)


def inverse(poses: Float64) -> Float64:
    """[N,6] the transforms that lead back."""
    poses = np.atleast_2d(poses)
    back = _rotation(poses).inv()
    return np.where(_known(poses), np.concatenate([back.as_rotvec(), -back.apply(poses[:, 3:])], axis=1), np.nan)


def angles(first: Float64, second: Float64) -> Float64:
    """[N] degrees between the rotations of two rows of transforms [N,6]; either may be one [6]."""
    first, second = _of_one_length(first, second)
    between = np.degrees((_rotation(first).inv() * _rotation(second)).magnitude())
    return np.where((_known(first) & _known(second))[:, 0], between, np.nan)


def _of_one_length(first: Float64, second: Float64) -> tuple[Float64, Float64]:
    count = max(len(np.atleast_2d(first)), len(np.atleast_2d(second)))
    return np.array(np.broadcast_to(first, (count, 6))), np.array(np.broadcast_to(second, (count, 6)))


def _known(poses: Float64) -> Bool:
    return np.asarray(np.isfinite(poses).all(axis=1, keepdims=True), np.bool_)


def _rotation(poses: Float64) -> Rotation:
    return Rotation.from_rotvec(np.where(_known(poses), poses, 0.0)[:, :3])


def median_pose(poses: Float64) -> tuple[Float64, Float64]:
    """The mean of the poses [6] near the one that all `poses` [N,6] agree with best, and their degrees from it [N]."""
    turns = Rotation.from_rotvec(poses[:, :3]).as_quat()
    blocks = np.split(turns, range(_BLOCK, len(turns), _BLOCK))  # not a pose at a time, which takes long
    halves = (np.arccos(np.minimum(np.abs(block @ turns.T), 1.0)) for block in blocks)
    spread = np.concatenate([np.minimum(np.degrees(2 * half), 20.0).sum(axis=1) for half in halves])
    middle = poses[int(spread.argmin())]
    away = angles(middle, poses)
    near = away <= max(2.0, 2 * float(np.median(away)))
    vector = Rotation.from_rotvec(poses[near, :3]).mean().as_rotvec()
    return np.concatenate([vector, np.median(poses[near, 3:], axis=0)]), away


def cross_matrices(vectors: Float64) -> Float64:
    """[N,3,3] matrices that multiply by `vectors` [N,3] as a cross product."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)


def left_jacobians(vectors: Float64) -> Float64:
    """[N,3,3] J of rotation vectors w [N,3], with which d(exp(w) y) = -[exp(w) y]x J dw.

    Source: J. Solà et al., A micro Lie theory for state estimation in robotics, equation 145.
    """
    angle = np.linalg.norm(vectors, axis=1)
    safe = np.maximum(angle, _SMALL)
    first = np.where(angle < 1e-4, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(angle < 1e-4, 1 / 6, (safe - np.sin(safe)) / safe**3)
    skew = cross_matrices(vectors)
    return np.asarray(np.eye(3) + first[:, None, None] * skew + second[:, None, None] * (skew @ skew), np.float64)
