"""Bundle adjustment: lenses, poses, time offsets, rolling shutters and board poses that explain all corners best.

See Triggs et al., Bundle adjustment: a modern synthesis, 1999. Weak priors hold what the corners do not determine, so
that a lens is not bent where the board never was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from streamlod.core.arrays import Bool, Float64
from streamlod.core.calibration.adjustment.certainty import standard_errors
from streamlod.core.calibration.adjustment.minimise import minimise
from streamlod.core.calibration.adjustment.observations import Observations
from streamlod.core.calibration.adjustment.residuals import (
    CLOCK,
    PER_CAMERA,
    AdjustedRig,
    flat_values,
    jacobian_of,
    misses_of,
    scene_of,
)
from streamlod.core.calibration.adjustment.timing import UnevenTimes
from streamlod.core.calibration.adjustment.unfolded import unfolded_lenses

_NOISE = 0.5  # pixels against which priors are weighed: corners of one picture err together, by blur and a bent board
_ROBUST, _FARTHEST = 2.0, 1.0  # times the noise, and pixels at most, from which a corner counts less
_ASPECT = 5e-4  # of the focal lengths' deviation: 0.5 % between that across and that down
_READOUT = 0.02  # seconds, standard deviation of what a picture takes to be read; phones take 0.01 to 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """The values that an adjustment leaves as they are.

    Attributes:
        root: camera that keeps its pose and clock.
        lenses: [C] cameras whose lenses stay. clocks: [C] cameras whose clocks do.
    """

    root: int
    lenses: Bool
    clocks: Bool


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """An adjustment's outcome.

    Attributes:
        scene: the best one.
        misses: [N,2] reprojection errors in pixels, less the part that uneven times explain.
        errors: [C,2] standard errors of the cameras' directions and places in the rig, radians and metres.
    """

    scene: AdjustedRig
    misses: Float64
    errors: Float64


def adjust(
    scene: AdjustedRig,
    seen: Observations,
    sizes: Sequence[tuple[int, int]],
    known: Known,
    uneven: UnevenTimes | None = None,
) -> Adjusted:
    """The scene that explains `seen` best, beginning at `scene`.

    Args:
        sizes: (width, height) of each camera's pictures.
        known: what stays.
        uneven: what is known of the times of the pictures in `seen`; exact ones by default.
    """
    count = len(scene.cameras)
    start = flat_values(scene)
    uneven = uneven or UnevenTimes(np.zeros(count))
    weights = uneven.weights(seen)
    free = np.ones(len(start), bool)
    by_camera = free[: count * PER_CAMERA].reshape(count, PER_CAMERA)
    by_camera[known.lenses, :9] = False
    by_camera[known.root, 9 : CLOCK + 1] = False
    by_camera[known.clocks, CLOCK] = False
    columns = np.flatnonzero(free)
    mean, deviation = _priors(sizes)
    first = count * PER_CAMERA
    unfolded = unfolded_lenses(scene.lenses, sizes, PER_CAMERA).only(free[:first])

    def full(values: Float64) -> Float64:
        whole = start.copy()
        whole[columns] = values
        return whole

    def residuals(values: Float64) -> Float64:
        whole = full(values)
        held = (whole[:first].reshape(count, -1) - mean) / deviation * _NOISE
        aspect = (whole[:first:PER_CAMERA] - whole[1:first:PER_CAMERA]) / (deviation[:, 0] * _ASPECT) * _NOISE
        parts = weights.of_misses(misses_of(scene_of(whole, count), seen)), held, aspect
        return np.concatenate([part.ravel() for part in parts])

    def slopes(values: Float64) -> csr_matrix:
        whole = full(values)
        jacobian = weights.of_slopes(jacobian_of(scene_of(whole, count), seen, len(start)))
        held = diags((_NOISE / deviation).ravel(), shape=(first, len(start)))
        each = np.arange(count) * PER_CAMERA
        weight = _NOISE / (deviation[:, 0] * _ASPECT)
        rows, places = np.tile(np.arange(count), 2), np.concatenate([each, each + 1])
        aspect = csr_matrix((np.concatenate([weight, -weight]), (rows, places)), (count, len(start)))
        return vstack([jacobian, held, aspect]).tocsr()[:, columns]

    scale = np.full(len(residuals(start[columns])), np.inf)  # of priors
    scale[: 2 * len(seen.camera)] = min(_ROBUST * uneven.noise, _FARTHEST)
    found = minimise(start[columns], residuals, slopes, scale, len(scene.boards), unfolded)
    best = scene_of(full(found.values), count)
    misses = weights.of_misses(misses_of(best, seen))
    places = (np.arange(count)[:, None] * PER_CAMERA + np.arange(9, 15)).ravel()

    def moved(moves: Float64) -> Float64:
        """Moves [M,A] of the first free values as those of all poses [M,C,6]."""
        whole = np.zeros((len(moves), len(start)))
        whole[:, columns[: moves.shape[1]]] = moves
        return whole[:, places].reshape(-1, count, 6)

    return Adjusted(best, misses, standard_errors(best.cameras, found, max(spread(misses), 0.05), moved))


def spread(misses: Float64) -> float:
    """Standard deviation of misses in pixels, outliers apart."""
    return 1.4826 * float(np.median(np.abs(misses))) if misses.size else 0.0


def _priors(sizes: Sequence[tuple[int, int]]) -> tuple[Float64, Float64]:
    """[C,18] means and standard deviations of the cameras' values: any focal length, the centre near the middle, little
    bending, and how long pictures may take to be read; poses and offsets are free."""
    means, deviations = [], []
    for width, height in sizes:
        long = max(width, height)
        means.append([long, long, (width - 1) / 2, (height - 1) / 2, *[0] * 14])
        lens = [long * 10, long * 10, long * 0.02, long * 0.02, 0.3, 0.3, 0.002, 0.002, 0.1]
        deviations.append([*lens, *[np.inf] * 7, _READOUT, _READOUT])
    return np.array(means), np.array(deviations)
