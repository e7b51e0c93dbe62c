"""Board walks whose truth is known: corners as distorted cameras would see them, with noise and time offsets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.projection import projected
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.track import Track
from streamlod.core.camera import look_at

BOARD = Board()


@dataclass(frozen=True)
class Rig:
    """Cameras as they truly are: [C,9] lenses, [C,6] world to camera, (width, height), names."""

    lenses: Float64
    poses: Float64
    size: tuple[int, int]
    names: tuple[str, ...]


def rig(count: int = 4, size: tuple[int, int] = (640, 480), radius: float = 3.0, arc: float = 150.0) -> Rig:
    """Cameras on an arc of `arc` degrees about the z axis, 1.6 m high; z is up."""
    lenses, poses = [], []
    for number in range(count):
        angle = np.radians(arc * (number / max(1, count - 1) - 0.5))
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), 1.6 + 0.15 * number])
        poses.append(rigid.pose(look_at(eye, np.array([0, 0, 1.0]), np.array([0, 0, 1.0]))))
        focal = size[0] * (0.8 + 0.03 * number)
        middle = [(size[0] - 1) / 2 + 3 * number, (size[1] - 1) / 2 - 2 * number]
        lenses.append([focal, focal * 1.003, *middle, -0.2 + 0.06 * number, 0.04, 0.0006, -0.0008, 0.0])
    return Rig(np.array(lenses), np.array(poses), size, tuple(f"cam_{number}" for number in range(count)))


def board_at(times: Float64) -> Float64:
    """[N,6] board to world of a person who walks about with it, holding it upright and turning; smooth in time."""
    t = np.asarray(times, np.float64)
    place = np.stack(
        [1.1 * np.sin(0.71 * t) + 0.15 * np.sin(2.3 * t), 1.1 * np.cos(0.53 * t), 1.1 + 0.5 * np.sin(1.1 * t)], axis=1
    )
    yaw = 0.9 * np.sin(0.37 * t + 1) + 0.2 * np.sin(1.9 * t)
    pitch, roll = 0.5 * np.sin(0.83 * t), 0.4 * np.sin(0.61 * t + 2)
    zero = np.zeros_like(t)
    # the board's x to the right as seen by the cameras, its y down, its z away from them
    facing = rigid.pose(np.array([[0, 0, -1.0, 0], [1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]]))
    tilt = np.stack([pitch, 0.5 * pitch, roll, zero, zero, zero], axis=1)
    about_z = np.stack([zero, zero, yaw, *place.T], axis=1)
    about_centre = np.concatenate([np.zeros(3), -BOARD.centre])
    return rigid.after(about_z, rigid.after(facing, rigid.after(tilt, about_centre)))


def corners_of(lens: Float64, pose: Float64, boards: Float64, size: tuple[int, int], board: Board = BOARD) -> Float64:
    """[K,J,2] pixels of the corners that lie inside the picture and face the camera; NaN for others."""
    to_camera = rigid.after(pose, boards)
    turns = rigid.rotations(to_camera[:, :3])
    points = board.corners @ turns.transpose(0, 2, 1) + to_camera[:, None, 3:]
    middles = points.mean(axis=1)
    facing = (turns[:, :, 2] * middles).sum(axis=1) / np.linalg.norm(middles, axis=1)
    ahead = (facing >= 0.3) & (points[..., 2].min(axis=1) >= 0.2)
    pixels = projected(lens, points.reshape(-1, 3))[0].reshape(*points.shape[:2], 2)
    inside = ahead[:, None] & ((pixels > 4) & (pixels < np.array(size) - 5)).all(axis=2)
    return np.where(inside[..., None], pixels, np.nan)


def walked(
    rig: Rig,
    seconds: float = 40.0,
    fps: float = 15.0,
    noise: float = 0.15,
    offsets: Float64 | None = None,
    seed: int = 1,
    boards: Callable[[Float64], Float64] = board_at,
    uneven: float = 0.0,
    readouts: Float64 | None = None,
) -> list[Track]:
    """Tracks of a walk; a camera's clock shows the common time less its offset, with errors of `uneven` seconds.

    `readouts`: [C] seconds from the capture of a picture's first line to that of its last; none by default.
    """
    random = np.random.default_rng(seed)
    offsets = np.zeros(len(rig.names)) if offsets is None else offsets
    tracks = []
    for number, name in enumerate(rig.names):
        clock = np.arange(int(seconds * fps)) / fps
        corners = corners_of(rig.lenses[number], rig.poses[number], boards(clock + offsets[number]), rig.size)
        if readouts is not None:
            corners = _read_by_lines(rig, number, boards, clock + offsets[number], readouts[number])
        stated = np.sort(clock + random.normal(0, uneven, len(clock))) if uneven else clock
        tracks.append(Track(name, rig.size, stated, corners + random.normal(0, noise, corners.shape)))
    return tracks


def stopping(rig: Rig, offsets: Float64, seconds: float = 30.0, fps: float = 10.0) -> list[Track]:
    """Tracks of a walk in which the board is held still for a second at a time, and is too blurred to be seen between.

    A camera's clock shows the common time less its offset.
    """
    tracks = walked(rig, seconds, fps, offsets=offsets, boards=lambda times: board_at(2.3 * np.floor(times)))
    found = []
    for track, offset in zip(tracks, offsets, strict=True):
        since = (track.times + offset) % 1.0
        seen = ((since > 0.2) & (since < 0.8))[:, None, None]
        found.append(replace(track, corners=np.where(seen, track.corners, np.nan)))
    return found


def _read_by_lines(
    rig: Rig, number: int, boards: Callable[[Float64], Float64], times: Float64, readout: float
) -> Float64:
    """Corners [K,J,2], each where it is when its line is read; the middle one at `times`."""
    step = 0.004  # seconds
    before, now, after = (
        corners_of(rig.lenses[number], rig.poses[number], boards(times + late), rig.size) for late in (-step, 0, step)
    )
    speed, bend = (after - before) / (2 * step), (after + before - 2 * now) / (2 * step**2)
    found = now
    for _ in range(3):
        late = readout * (found[..., 1:] / rig.size[1] - 0.5)
        found = now + late * (speed + late * bend)
    return found
