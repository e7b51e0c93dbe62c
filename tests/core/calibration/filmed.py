"""Pictures of a board as a distorted camera films it, and footage made of pictures."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from streamlod.core.arrays import Float32, Float64, UInt8
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.projection import matrix_of
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.board.printing import squares
from streamlod.core.calibration.walk import WalkFootage

_CELL = 24  # pixels of a square in the board's picture, about as large as it is filmed


def rays_of(lens: Float64, size: tuple[int, int]) -> Float64:
    """[2H * 2W,2] where the rays of a picture twice as fine meet the plane z = 1."""
    rows, columns = np.mgrid[: 2 * size[1], : 2 * size[0]] / 2 - 0.25
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    return np.asarray(cv2.undistortPoints(pixels[:, None], matrix_of(lens), lens[4:])[:, 0], np.float64)


def filmed(rays: Float64, to_camera: Float64, size: tuple[int, int], board: Board, seed: int = 0) -> UInt8:
    """[H,W,3] picture of the board alone in a grey room: distorted, a little blurred, noisy.

    Args:
        rays: those of `rays_of`.
        to_camera: [6] board to camera; of a moving board [S,2H,6] at moments of the exposure, of which the picture is
            the mean, for each row of a picture twice as fine.
    """
    moments = to_camera if to_camera.ndim == 3 else to_camera[None, None]
    fine = np.mean([_fine(rays.reshape(2 * size[1], -1, 2), rows, board) for rows in moments], axis=0, dtype=np.float32)
    picture = cv2.GaussianBlur(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    noisy = picture + np.random.default_rng(seed).normal(0, 2, picture.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _fine(rays: Float64, to_camera: Float64, board: Board) -> Float32:
    """[R,Q] picture along rays [R,Q,2], by a pose [R,6] for each of its rows, or one [1,6] for all."""
    turns = rigid.rotations(to_camera[:, :3])
    # the ray s (x, y, 1) meets the plane turn (u, v, 0) + move
    planes = np.linalg.inv(np.stack([turns[:, :, 0], turns[:, :, 1], to_camera[:, 3:]], axis=2))
    u, v, w = np.moveaxis(rays @ planes[:, :, :2].swapaxes(1, 2) + planes[:, None, :, 2], 2, 0)
    scale = _CELL / board.square_m
    across, down = (np.where(w > 0, (each / w) * scale - 0.5, -1e4).astype(np.float32) for each in (u, v))
    margin = _CELL // 2  # of white paper
    paper = cv2.copyMakeBorder(squares(board, _CELL), *[margin] * 4, cv2.BORDER_CONSTANT, value=255)
    drawn = cv2.remap(
        np.asarray(40 + 0.7 * paper, np.float32),
        across + margin,
        down + margin,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=110,
    )
    return np.asarray(drawn, np.float32)


def footage_of(camera: str, pictures: Sequence[UInt8], fps: float = 10.0) -> WalkFootage:
    """The footage that consists of `pictures`."""
    height, width = pictures[0].shape[:2]
    return WalkFootage(camera, (width, height), np.arange(len(pictures)) / fps, lambda: iter(pictures))
