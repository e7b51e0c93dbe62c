"""Bundle adjustment: lenses, poses, time offsets, rolling shutters and board poses that explain all corners best.

The residual of a corner is its projection less the camera's curve of that corner at the instant, by the camera's own
clock and by where in the picture the corner is, as most cameras read a picture line by line (Triggs et al., Bundle
adjustment: a modern synthesis, 1999; Oth et al., Rolling shutter camera calibration, 2013). Weak priors hold what the
corners do not tell, so that a lens is not bent where the board never was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack

from streamlod.core.arrays import Bool, Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.adjustment.certainty import standard_errors
from streamlod.core.calibration.adjustment.minimise import minimise
from streamlod.core.calibration.adjustment.observations import Observations, curve_noise
from streamlod.core.calibration.adjustment.projection import projected
from streamlod.core.calibration.adjustment.timing import UnevenTimes
from streamlod.core.calibration.adjustment.unfolded import unfolded_lenses

_NOISE = 0.5  # pixels against which priors are weighed: corners of one picture err together, by blur and a bent board
_ROBUST, _FARTHEST = 2.0, 1.0  # times the noise, and pixels at most, from which a corner counts less
_ASPECT = 5e-4  # of the focal lengths' deviation: 0.5 % between that across and that down
_READOUT = 0.02  # seconds, standard deviation of what a picture takes to be read; phones take 0.01 to 0.03
_PER_CAMERA = 18  # lens 9, pose 6, offset 1, readouts 2
_CLOCK, _READOUTS = 15, slice(16, 18)


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
    start = _flat(scene)
    uneven = uneven or UnevenTimes(np.zeros(count))
    weights = uneven.weights(seen)
    free = np.ones(len(start), bool)
    by_camera = free[: count * _PER_CAMERA].reshape(count, _PER_CAMERA)
    by_camera[known.lenses, :9] = False
    by_camera[known.root, 9 : _CLOCK + 1] = False
    by_camera[known.clocks, _CLOCK] = False
    columns = np.flatnonzero(free)
    mean, deviation = _priors(sizes)
    first = count * _PER_CAMERA
    unfolded = unfolded_lenses(scene.lenses, sizes, _PER_CAMERA).only(free[:first])

    def full(values: Float64) -> Float64:
        whole = start.copy()
        whole[columns] = values
        return whole

    def residuals(values: Float64) -> Float64:
        whole = full(values)
        held = (whole[:first].reshape(count, -1) - mean) / deviation * _NOISE
        aspect = (whole[:first:_PER_CAMERA] - whole[1:first:_PER_CAMERA]) / (deviation[:, 0] * _ASPECT) * _NOISE
        parts = weights.of_misses(misses_of(_scene(whole, count), seen)), held, aspect
        return np.concatenate([part.ravel() for part in parts])

    def slopes(values: Float64) -> csr_matrix:
        whole = full(values)
        jacobian = weights.of_slopes(_jacobian(_scene(whole, count), seen, len(start)))
        held = diags((_NOISE / deviation).ravel(), shape=(first, len(start)))
        each = np.arange(count) * _PER_CAMERA
        weight = _NOISE / (deviation[:, 0] * _ASPECT)
        rows, places = np.tile(np.arange(count), 2), np.concatenate([each, each + 1])
        aspect = csr_matrix((np.concatenate([weight, -weight]), (rows, places)), (count, len(start)))
        return vstack([jacobian, held, aspect]).tocsr()[:, columns]

    scale = np.full(len(residuals(start[columns])), np.inf)  # of priors
    scale[: 2 * len(seen.camera)] = min(_ROBUST * uneven.noise, _FARTHEST)
    found = minimise(start[columns], residuals, slopes, scale, len(scene.boards), unfolded)
    best = _scene(full(found.values), count)
    misses = weights.of_misses(misses_of(best, seen))
    places = (np.arange(count)[:, None] * _PER_CAMERA + np.arange(9, 15)).ravel()

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


def _flat(scene: AdjustedRig) -> Float64:
    cameras = np.concatenate([scene.lenses, scene.cameras, scene.offsets[:, None], scene.readouts], axis=1)
    return np.concatenate([cameras.ravel(), scene.boards.ravel()])


def _scene(values: Float64, count: int) -> AdjustedRig:
    cameras = values[: count * _PER_CAMERA].reshape(count, _PER_CAMERA)
    boards = values[count * _PER_CAMERA :].reshape(-1, 6)
    return AdjustedRig(cameras[:, :9], cameras[:, 9:15], cameras[:, _CLOCK], cameras[:, _READOUTS], boards)


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


def _jacobian(scene: AdjustedRig, seen: Observations, width: int) -> csr_matrix:
    """[2N,width] derivatives of the residuals by all values in the order of `_flat`."""
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
    first = len(scene.cameras) * _PER_CAMERA
    places = np.concatenate(
        [
            seen.camera[:, None] * _PER_CAMERA + np.arange(_PER_CAMERA),
            first + seen.instant[:, None] * 6 + np.arange(6),
        ],
        axis=1,
    )
    count = values.shape[2]
    columns = np.repeat(places, 2, axis=0).ravel()
    return csr_matrix((values.ravel(), columns, np.arange(0, len(columns) + 1, count)), (2 * len(moved), width))
