"""The world's axes: z up, and the floor at z = 0 where the board lay on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid

_FLAT = 15.0  # degrees between the board's normal and up, of a board that lies
_STILL = 0.03  # metres a second of a board that lies
_LOW = 0.1  # metres that a board on the floor may lie above the lowest place of the walk


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Where the world lies in the axes of the adjustment.

    Attributes:
        to_world: [6] from these axes to the world's.
        by_board: whether the board lay on the floor; else up is the cameras', and z = 0 the walk's lowest place.
    """

    to_world: Float64
    by_board: bool


def find_floor(cameras: Float64, boards: Float64, times: Float64, centre: Float64) -> Floor:
    """The floor, from a board that lay still, flat and lowest, or else from how the cameras are held.

    Args:
        cameras: [C,6] to camera. boards: [I,6] board to the axes of the adjustment. times: [I] seconds, ascending.
        centre: [3] of the board.
    """
    up = up_of(cameras)
    turns = rigid.rotations(boards[:, :3])
    places = np.einsum("nij,j->ni", turns, centre) + boards[:, 3:]
    heights = places @ up
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.maximum(np.diff(times), 1e-6)
    slow = np.append(steps < _STILL, False) | np.append(False, steps < _STILL)
    normals = -turns[:, :, 2]  # out of the print, as z leads into the board
    flat = normals @ up > np.cos(np.radians(_FLAT))
    lying = slow & flat & (heights < heights.min() + _LOW)
    if lying.sum() >= 3:
        up = normals[lying].mean(axis=0)
        up = up / np.linalg.norm(up)
        origin = places[lying].mean(axis=0)
    else:
        origin = np.median(places, axis=0)
        origin = origin + up * (heights.min() - origin @ up)
    return Floor(axes_of(cameras, up, origin), bool(lying.sum() >= 3))


def axes_of(cameras: Float64, up: Float64, origin: Float64) -> Float64:
    """[6] from the axes of cameras [C,6] to those of a world with this origin [3]: z up, y away from the cameras."""
    ahead = -rigid.inverse(cameras)[:, 3:].mean(axis=0) + origin
    ahead = ahead - up * (ahead @ up)
    if np.linalg.norm(ahead) < 1e-3:
        ahead = np.cross(up, [1.0, 0, 0]) if abs(up[0]) < 0.9 else np.cross(up, [0, 1.0, 0])
    y = ahead / np.linalg.norm(ahead)
    axes = np.stack([np.cross(y, up), y, up])
    return np.concatenate([Rotation.from_matrix(axes).as_rotvec(), -axes @ origin])


def up_of(cameras: Float64) -> Float64:
    """[3] up as most cameras are held; some may be upside down or on their sides.

    Either the across or the down axis of a camera on a tripod is level: up is square to all of these.
    """
    turns = rigid.rotations(cameras[:, :3])  # rows: the camera's x, y, z
    ups = -turns[:, 1]
    agree = np.abs(ups @ ups.T).sum(axis=1)
    first = ups[int(agree.argmax())]
    # a camera on its side holds its x axis upright: the level axis is the one that is farther from up
    level = np.where((np.abs(turns[:, 0] @ first) <= np.abs(ups @ first))[:, None], turns[:, 0], turns[:, 1])
    powers, axes = np.linalg.eigh(level.T @ level)
    up = axes[:, 0] if powers[1] > 1e-3 * powers[2] else (ups * np.sign(ups @ first)[:, None]).mean(axis=0)
    votes = np.sign(ups @ up)[np.abs(ups @ up) > 0.5]
    sign = float(votes.sum()) or float(up @ first)
    return np.asarray(up / np.linalg.norm(up) * (1.0 if sign >= 0 else -1.0), np.float64)
