"""First points on synthetic clips, where depth is known: how many are wrong, how many hang in free space, coverage.

    python -m tests.bench.first_points_bench [--kind bright --views 3 5 --width 480 --exposure 0.0 --method auto]

Prints, for each number of views: points, those in free space (seen through by a camera, a tenth of the depth or more
before everything within 13 pixels of 480, and on no camera's surface) a 10,000, the share off the surface (3 % of the
depth), the share of the pictures' 8x8 cells that hold a right point, and the CPU time (the first run compiles).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter

from streamlod.core.arrays import Float32
from streamlod.core.camera import Camera
from streamlod.core.data import linspace_split
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points
from streamlod.core.initialise.views import inside, project
from streamlod.core.synthetic import SyntheticSpec, ground_truth, open_synthetic

_ON, _BEFORE = 0.03, 0.1  # relative depths: this near is on a surface, this far before it is in free space
_ROOM = 13 / 480  # of the width, within which a nearer surface excuses a point: matched windows widen what is near
_CELL = 8


@dataclass(frozen=True, slots=True)
class PointScore:
    """What a cloud is worth: its size, points in free space, shares off every surface and of cells covered."""

    points: int
    free: int
    off: float
    covered: float

    @property
    def free_in_10000(self) -> float:
        """Points in free space of 10,000."""
        return 1e4 * self.free / max(self.points, 1)


def score_points(points: PointCloud, cameras: list[Camera], depths: list[Float32]) -> PointScore:
    """Compare `points` with the true `depths` [H,W] of `cameras`."""
    positions = points.positions.astype(np.float64)
    through, on = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    covered = []
    for camera, depth in zip(cameras, depths, strict=True):
        pixels, z = project(camera, positions)
        seen = inside(camera, pixels, z)
        column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
        near = minimum_filter(depth, 2 * round(_ROOM * camera.width / 2) + 1)
        right = seen & (np.abs(z / depth[row, column] - 1) < _ON)
        on |= right
        through |= seen & (z < (1 - _BEFORE) * near[row, column])
        cells = np.zeros((-(-camera.height // _CELL), -(-camera.width // _CELL)), np.bool_)
        cells[row[right] // _CELL, column[right] // _CELL] = True
        covered.append(cells.mean())
    return PointScore(len(points), int((through & ~on).sum()), float((~on).mean()), float(np.mean(covered)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kind", default="bright")
    parser.add_argument("--views", type=int, nargs="+", default=[3, 5])
    parser.add_argument("--width", type=int, default=480)
    parser.add_argument("--exposure", type=float, default=0.0, help="spread of the cameras' exposures in stops")
    parser.add_argument("--method", default="auto")
    parser.add_argument("--unknown-bounds", action="store_true", help="have the depth bounds estimated")
    options = parser.parse_args()
    size = {"width": options.width, "height": options.width * 9 // 16}
    spec = SyntheticSpec(frames=1, kind=options.kind, exposure_spread=options.exposure, **size)
    dataset = open_synthetic(spec)
    whole = next(iter(dataset.frames()))
    for views in options.views:
        rows = [dataset.names.index(name) for name in linspace_split(dataset.names, views, ("cam00",)).train]
        cameras = [dataset.cameras[row] for row in rows]
        frame, began = FrameSet(0, 0, whole.images[rows], whole.present[rows]), time.process_time()
        bounds = None if options.unknown_bounds else dataset.depth_bounds
        points = first_points(frame, cameras, depth_bounds=bounds, method=options.method)
        seconds = time.process_time() - began
        score = score_points(points, cameras, [ground_truth(spec, 0, row).depth for row in rows])
        print(
            f"{options.kind} {views} views: {score.points} points, {score.free_in_10000:.2f} of 10,000 in free space, "
            f"{score.off:.3f} off the surface, {score.covered:.3f} of the cells covered, {seconds:.1f} s CPU",
            flush=True,
        )


if __name__ == "__main__":
    main()
