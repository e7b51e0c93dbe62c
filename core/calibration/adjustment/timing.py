"""Times of pictures that are not quite those stated: phones and browsers stamp unevenly.

Such an error moves all corners of a picture along their paths, so that their errors are correlated: a picture that is 5
milliseconds late counts like two dozen corners that agree on a wrong lens. So in each picture the part of the misses
along the corners' motion is weighted down, the more so the more uneven the camera's times are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags

from streamlod.core.arrays import Float64, Int64
from streamlod.core.calibration.adjustment.observations import Observations

_LEAST_NOISE = 0.05  # pixels
_FAR = 5.0  # scatters, to which larger misses are cut


@dataclass(frozen=True, slots=True, eq=False)
class PictureWeights:
    """Weights of misses, of which those of one picture along its corners' motion are correlated.

    Attributes:
        motion: [2N,Q] for each of Q pictures its corners' motion, as a unit vector.
        left_out: [Q] part of the misses along the motion that is removed, so that the rest scatters as across it.
    """

    motion: csr_matrix
    left_out: Float64

    def of_misses(self, misses: Float64) -> Float64:
        """[N,2] misses [N,2] weighted so that they scatter alike in all directions."""
        flat = misses.ravel()
        return np.asarray(flat - self.motion @ (self.left_out * (self.motion.T @ flat)), np.float64).reshape(-1, 2)

    def of_slopes(self, slopes: csr_matrix) -> csr_matrix:
        """[2N,P] derivatives of the weighed misses from those of the misses."""
        return (slopes - self.motion @ (diags(self.left_out) @ (self.motion.T @ slopes))).tocsr()


@dataclass(frozen=True, slots=True, eq=False)
class UnevenTimes:
    """How uneven the cameras' times are: standard deviations [C] in seconds, beside `noise` of corners in pixels."""

    seconds: Float64
    noise: float = 1.0

    def weights(self, seen: Observations) -> PictureWeights:
        """The weights of these observations' misses."""
        cameras, of_row, speeds = _pictures(seen)
        rows = np.arange(2 * len(of_row))
        units = seen.slope / np.maximum(speeds, 1e-9)[of_row, None]
        motion = csr_matrix((units.ravel(), (rows, np.repeat(of_row, 2))), (len(rows), len(cameras)))
        return PictureWeights(motion, 1 - 1 / np.hypot(1, self.seconds[cameras] * speeds / self.noise))


def uneven_times(seen: Observations, misses: Float64, cameras: int) -> UnevenTimes:
    """How uneven the times of that many `cameras` are: by how much the misses [N,2] along the corners' motion exceed
    those across it, in both of which other errors that a picture's corners share appear."""
    of_picture, of_row, speeds = _pictures(seen)
    safe = np.maximum(speeds, 1e-9)
    along = np.bincount(of_row, (seen.slope * misses).sum(axis=1)) / safe
    across = np.bincount(of_row, seen.slope[:, 0] * misses[:, 1] - seen.slope[:, 1] * misses[:, 0]) / safe
    rest = misses - (along / safe)[of_row, None] * seen.slope
    seconds = np.zeros(cameras)
    for number in range(cameras):
        mine = of_picture == number
        if mine.any():
            cut = _FAR * 1.4826 * float(np.median(np.abs(along[mine])))
            most = (np.minimum(np.abs(each[mine]), cut) for each in (along, across))
            more = np.subtract(*((each**2).sum() for each in most))
            seconds[number] = np.sqrt(max(0.0, float(more)) / max(float((speeds[mine] ** 2).sum()), 1e-9))
    return UnevenTimes(seconds, max(_LEAST_NOISE, 1.4826 * float(np.median(np.abs(rest)))))


def _pictures(seen: Observations) -> tuple[Int64, Int64, Float64]:
    """[Q] the camera of each picture in which corners are seen, [N] the picture of each corner, and [Q] how fast the
    corners move there: the root of the sum of their squared speeds in pixels a second."""
    width = int(seen.instant.max(initial=0)) + 1
    keys, of_row = np.unique(seen.camera * width + seen.instant, return_inverse=True)
    return keys // width, of_row, np.sqrt(np.bincount(of_row, (seen.slope**2).sum(axis=1)))
