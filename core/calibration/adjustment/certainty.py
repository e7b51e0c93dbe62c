"""Standard errors of camera poses: from the noise of corners, and from leaving out parts of the walk.

The noise of corners gives a lower bound. Errors that pictures near in time share (blur, a bent board, curves between
pictures) show in how far the minimum moves without these pictures: the jackknife with groups left out (Shao and Tu, The
jackknife and bootstrap, 1995, section 9.2), by one step of Newton's method each.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.minimise import BLOCK, Minimum

_PARTS = 25  # of the walk
_LEFT_OUT = 0.9  # of a part's weight: what one part alone tells stays determined


def standard_errors(
    cameras: Float64, minimum: Minimum, deviation: float, poses: Callable[[Float64], Float64]
) -> Float64:
    """[C,2] standard errors of directions and places in the rig, radians and metres; infinite where undetermined.

    Args:
        cameras: [C,6] world to camera.
        deviation: of the residuals' noise.
        poses: the part [M,C,6] of moves [M,A] of the minimum's first values that is the cameras'.
    """
    try:
        moves = _noise_moves(minimum, deviation), _part_moves(minimum)
    except np.linalg.LinAlgError:
        return np.full((len(cameras), 2), np.inf)
    noise, parts = (_sizes_in_rig(cameras, poses(each)) for each in moves)
    return np.maximum(noise, parts)


def _noise_moves(minimum: Minimum, deviation: float) -> Float64:
    """[A,A] moves m of the first values, whose covariance is m^T m where residuals have this standard deviation."""
    lower = np.linalg.cholesky(minimum.normal.damped(1e-12).reduced()[0])
    return np.asarray(deviation * solve_triangular(lower, np.eye(len(lower)), lower=True), np.float64)


def _part_moves(minimum: Minimum) -> Float64:
    """[G,A] moves m of the first values, whose covariance is m^T m by G parts of the boards in their order."""
    whole, ratio = minimum.normal.damped(1e-12).reduced()
    count, boards = len(whole), len(minimum.normal.boards)
    by_board = minimum.slopes[:, count:].tocsc()
    edges = np.linspace(0, boards, min(_PARTS, boards) + 1).astype(int)
    moves = np.zeros((len(edges) - 1, count))
    for number, (begin, end) in enumerate(pairwise(edges)):
        rows = np.unique(by_board[:, begin * BLOCK : end * BLOCK].indices)
        slopes, weights = minimum.slopes[rows][:, :count], minimum.weights[rows]
        own = (slopes.T @ slopes.multiply(weights[:, None]).tocsr()).toarray()
        mixed = minimum.normal.mixed[:, begin:end].reshape(count, -1)
        own -= ratio[:, begin:end].reshape(count, -1) @ mixed.T
        moves[number] = np.linalg.solve(whole - _LEFT_OUT * own, slopes.T @ (weights * minimum.residuals[rows]))
    return np.asarray((moves - moves.mean(axis=0)) * np.sqrt(1 - 1 / max(2, len(moves))), np.float64)


def _sizes_in_rig(cameras: Float64, moves: Float64) -> Float64:
    """[C,2] root of the sum of squares of `moves` [M,C,6] of `cameras` [C,6], as turns in radians and shifts in metres,
    both relative to the rig's mean."""
    turns = rigid.rotations(cameras[:, :3])
    centres = -np.einsum("cji,cj->ci", turns, cameras[:, 3:])
    spun = np.einsum("cij,mcj->mci", rigid.left_jacobians(cameras[:, :3]), moves[:, :, :3])
    turned = np.einsum("cji,mcj->mci", turns, spun)  # in the world's axes
    shifted = np.cross(spun, cameras[:, 3:]) - moves[:, :, 3:]
    shifted = np.einsum("cji,mcj->mci", turns, shifted)
    common = turned.mean(axis=1, keepdims=True)
    shifted = shifted - shifted.mean(axis=1, keepdims=True) - np.cross(common, centres - centres.mean(axis=0))
    squares = [(each**2).sum(axis=(0, 2)) for each in (turned - common, shifted)]
    return np.asarray(np.sqrt(np.stack(squares, axis=1)), np.float64)
