"""Residuals of an adjustment and their derivatives by all values of its scene.

The residual of a corner is its projection less the camera's curve of that corner at the instant, by the camera's own
clock and by where in the picture the corner is, as most cameras read a picture line by line (Oth et al., Rolling
shutter camera calibration, 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.observations import Observations, curve_noise
from streamlod.core.calibration.adjustment.projection import projected

PER_CAMERA = 18  # lens 9, pose 6, offset 1, readouts 2
CLOCK, _READOUTS = 15, slice(16, 18)


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedRig:
    """Everything that is adjusted.

    Attributes:
        lenses: [C,9]. cameras: [C,6] world to camera. offsets: [C] seconds from a camera's clock to the common time.
        readouts: [C,2] seconds from the capture of a picture's left edge to that of its right one, and from top to
            bottom; its middle is captured at the picture's time.
        boards: [I,6] board to world.
    """

    lenses: Float64
    cameras: Float64
    offsets: Float64
    readouts: Float64
    boards: Float64


def flat_values(scene: AdjustedRig) -> Float64:
    """All values as one vector: `PER_CAMERA` of each camera, then six of each board."""
    cameras = np.concatenate([scene.lenses, scene.cameras, scene.offsets[:, None], scene.readouts], axis=1)
    return np.concatenate([cameras.ravel(), scene.boards.ravel()])


def scene_of(values: Float64, count: int) -> AdjustedRig:
    """Inverse of `flat_values`, for `count` cameras."""
    cameras = values[: count * PER_CAMERA].reshape(count, PER_CAMERA)
    boards = values[count * PER_CAMERA :].reshape(-1, 6)
    return AdjustedRig(cameras[:, :9], cameras[:, 9:15], cameras[:, CLOCK], cameras[:, _READOUTS], boards)


@dataclass(frozen=True, slots=True, eq=False)
class _OnCurves:
    """Corners on the cameras' curves, N of them.

    A curve gives the corner in a picture taken t seconds after the nearest one. A rolling shutter captures the corner
    readouts . place later than the picture's middle; t is such that both add up to `since`.

    Attributes:
        at: [N,2] pixels. speed: [N,2] pixels a second.
        noise: [N,1] noise relative to that in a picture. growth: [N,1] its derivative by t.
        by_clock: [N,3] derivatives of t by the camera's offset and readouts.
    """

    at: Float64
    speed: Float64
    noise: Float64
    growth: Float64
    by_clock: Float64


def _on_curves(scene: AdjustedRig, seen: Observations) -> _OnCurves:
    readouts = scene.readouts[seen.camera]
    place = seen.value / seen.extent - 0.5
    pace = 1 + (readouts * seen.slope / seen.extent).sum(axis=1)
    t = ((seen.since - scene.offsets[seen.camera] - (readouts * place).sum(axis=1)) / pace)[:, None]
    by_readout = place + t * seen.slope / seen.extent
    by_clock = -np.concatenate([np.ones_like(t), by_readout], axis=1) / pace[:, None]
    at, speed = seen.value + t * (seen.slope + t * seen.bend), seen.slope + 2 * t * seen.bend
    noise, growth = (seen.doubt[:, None] * each for each in curve_noise(t[:, 0], seen.neighbours))
    return _OnCurves(at, speed, noise, growth, by_clock)


def misses_of(scene: AdjustedRig, seen: Observations) -> Float64:
    """[N,2] reprojection errors in pixels, each divided by the relative noise of its corner's curve.

    Between pictures a curve has less noise than at them. Without the division, clocks would drift to where it is least.
    """
    curves = _on_curves(scene, seen)
    return (projected(scene.lenses[seen.camera], _turned(scene, seen)[1])[0] - curves.at) / curves.noise


def _turned(scene: AdjustedRig, seen: Observations) -> tuple[tuple[Float64, Float64], Float64]:
    """Points rotated by their boards, these in the world rotated by their cameras, [N,3] each; and points in camera
    axes [N,3]."""
    by_board = np.einsum("nij,nj->ni", rigid.rotations(scene.boards[:, :3])[seen.instant], seen.point)
    world = by_board + scene.boards[seen.instant, 3:]
    by_camera = np.einsum("nij,nj->ni", rigid.rotations(scene.cameras[:, :3])[seen.camera], world)
    return (by_board, by_camera), by_camera + scene.cameras[seen.camera, 3:]


def jacobian_of(scene: AdjustedRig, seen: Observations, width: int) -> csr_matrix:
    """[2N,width] derivatives of the residuals by all values in the order of `flat_values`."""
    (by_board, by_camera), moved = _turned(scene, seen)
    pixels, by_point, by_lens = projected(scene.lenses[seen.camera], moved)
    curves = _on_curves(scene, seen)
    camera_turn = -rigid.cross_matrices(by_camera) @ rigid.left_jacobians(scene.cameras[:, :3])[seen.camera]
    by_world = by_point @ rigid.rotations(scene.cameras[:, :3])[seen.camera]
    board_turn = -rigid.cross_matrices(by_board) @ rigid.left_jacobians(scene.boards[:, :3])[seen.instant]
    by_time = (
        -(curves.speed + (pixels - curves.at) * curves.growth / curves.noise)[:, :, None] * curves.by_clock[:, None]
    )
    parts = [by_lens, by_point @ camera_turn, by_point, by_time, by_world @ board_turn, by_world]
    values = np.concatenate(parts, axis=2) / curves.noise[:, :, None]
    first = len(scene.cameras) * PER_CAMERA
    places = np.concatenate(
        [
            seen.camera[:, None] * PER_CAMERA + np.arange(PER_CAMERA),
            first + seen.instant[:, None] * 6 + np.arange(6),
        ],
        axis=1,
    )
    count = values.shape[2]
    columns = np.repeat(places, 2, axis=0).ravel()
    return csr_matrix((values.ravel(), columns, np.arange(0, len(columns) + 1, count)), (2 * len(moved), width))
