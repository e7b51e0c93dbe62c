"""Corners of a small board as `calibrate` finds them and as OpenCV alone does, beside the truth.

    python -m tests.bench.board_bench [--size 640x480 --count 60]

A distorted camera films a board at several distances, a little blurred and noisy. For each width of a square in pixels:
corners found of those in the picture, their root mean square error where it is less than a pixel, the share beyond
that, and milliseconds a picture.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from streamlod.core.arrays import Float64, UInt8
from streamlod.core.calibration.board.description import Board
from streamlod.core.calibration.board.detect import Detector
from tests.core.calibration import walks
from tests.core.calibration.filmed import filmed, rays_of

_SQUARES = (10, 13, 16, 20, 25, 32, 45)  # pixels


def sights(rig: walks.Rig, board: Board, square: float, count: int) -> list[tuple[UInt8, Float64]]:
    """Pictures of the first camera with squares of about so many pixels, and the corners' true pixels."""
    random, rays, found = np.random.default_rng(int(square)), rays_of(rig.lenses[0], rig.size), []
    away = rig.lenses[0, 0] * board.square_m / square
    while len(found) < count:
        turn = random.uniform(-0.6, 0.6, 3)
        aside = away * random.uniform(-0.35, 0.35, 2)
        pose = np.array([*turn, *(aside - board.centre[:2]), away])
        truth = walks.corners_of(rig.lenses[0], np.zeros(6), pose[None], rig.size, board)[0]
        if np.isfinite(truth).any():
            found.append((filmed(rays, pose, rig.size, board, len(found)), truth))
    return found


def by_opencv(board: Board) -> Callable[[UInt8], Float64]:
    """Corners as OpenCV finds them by its own choices."""
    detector = cv2.aruco.CharucoDetector(board.opencv())

    def find(picture: UInt8) -> Float64:
        points, ids, _, _ = detector.detectBoard(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
        corners = np.full((board.corner_count, 2), np.nan)
        if ids is not None and len(ids) >= 4:
            corners[np.ravel(ids)] = np.reshape(points, (-1, 2))
        return corners

    return find


def told(find: Callable[[UInt8], Float64], shots: list[tuple[UInt8, Float64]]) -> str:
    """Cells of the table for one way to find corners."""
    begin = time.process_time()
    errors = np.concatenate([np.linalg.norm(find(picture) - truth, axis=1) for picture, truth in shots])
    seconds = (time.process_time() - begin) / len(shots)
    errors = errors[np.isfinite(errors)]
    near = errors[errors < 1]
    share = len(errors) / sum(int(np.isfinite(truth[:, 0]).sum()) for _, truth in shots)
    error = np.sqrt((near**2).mean()) if len(near) else np.nan
    return f"{share:.0%} | {error:.3f} | {1 - len(near) / max(1, len(errors)):.1%} | {1000 * seconds:.0f}"


def main() -> None:
    """Film, find and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--count", type=int, default=60)
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    rig, board = walks.rig(4, (width, height)), Board()
    detector = Detector(board)
    print("| square, pixels | OpenCV: found | error, px | beyond 1 px | ms | ours: found | error | beyond | ms |")
    print("| --- " * 9 + "|")
    for square in _SQUARES:
        shots = sights(rig, board, square, given.count)
        alone, ours = told(by_opencv(board), shots), told(lambda picture: detector(picture).corners, shots)
        print(f"| {square} | {alone} | {ours} |", flush=True)


if __name__ == "__main__":
    main()
