"""Points of depth maps that a neural network predicts, placed into cameras that are already known.

A network predicts depth in a scale of its own, and that of one view does not quite fit that of another. So depths are
brought to the scale of the known cameras, then each view gets a scale and a shift with which the views agree, and what
still does not agree is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.consistency import consistent_points
from streamlod.core.initialise.stereo.sweep import DepthMap
from streamlod.core.initialise.views import WorkingViews, inside, pixel_centres

_PATCH = 14  # DINOv2, which VGGT and Depth Anything 3 begin with, takes pictures whose sides are multiples of this
_DOUBTFUL = 0.2  # the fraction of pixels, those of least confidence, that is not used
_ROUNDS = 30
_STEP = 3  # every so many pixels in each direction vote on scale and shift
_GATE = (0.3, 0.02)  # relative depth difference that still counts, in the first and the last round
_PRIOR, _GAUGE = 1e-3, 1e3  # weights of no change of a view, and of the mean of all views, relative to the votes
_REFUSED = 2.0  # the cost of a pixel that is not used


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDepth:
    """The prediction of a network for V views.

    Attributes:
        depth: [V,H,W] along the optical axis, in the prediction's own scale.
        confidence: [V,H,W], higher is better.
        poses: [V,3,4] or [V,4,4] world_to_camera in the same scale.
    """

    depth: Float32
    confidence: Float32
    poses: Float64


def predicted_points(views: WorkingViews, side: int, predict: Callable[[WorkingViews], PredictedDepth]) -> PointCloud:
    """Points of what `predict` says of the views, whose longer side it sees with `side` pixels.

    Raises:
        InputError: fewer than two views, or cameras that all stand at one place.
    """
    if len(views) < 2:
        raise InputError(
            "first points", "a network needs pictures of at least two cameras; use a points file or random"
        )
    small = model_views(views, side)
    return place_depth(small, predict(small))


def model_views(views: WorkingViews, side: int) -> WorkingViews:
    """The views at the size that a network takes: the longer side `side` pixels, both multiples of 14."""
    width, height = views.size
    factor = side / max(width, height)
    columns, rows = (max(_PATCH, _PATCH * round(length * factor / _PATCH)) for length in (width, height))
    images = [cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA) for image in views.images]
    return WorkingViews(tuple(camera.scaled(columns, rows) for camera in views.cameras), np.stack(images))


def place_depth(views: WorkingViews, predicted: PredictedDepth) -> PointCloud:
    """Points of predicted depth maps, of the size of the views, in the space of the known cameras.

    Raises:
        InputError: all cameras stand at one place, in the world or in the prediction.
    """
    start = global_scale(views.cameras, predicted.poses)
    depth, confidence = predicted.depth, predicted.confidence
    usable = (confidence > np.quantile(confidence, _DOUBTFUL)) & (depth > 0) & np.isfinite(depth)
    scale, shift = fit_scale_and_shift(views.cameras, np.where(usable, depth, 0.0).astype(np.float64), start)
    maps = []
    for index, camera in enumerate(views.cameras):
        placed = np.asarray(scale[index] * depth[index] + shift[index], np.float32)
        good = usable[index] & (placed > 0)
        cost = np.where(good, 0, _REFUSED).astype(np.float32)
        maps.append(DepthMap(camera, np.where(good, placed, 1).astype(np.float32), cost))
    return consistent_points(views, maps)


def global_scale(cameras: Sequence[Camera], predicted: Float64) -> float:
    """World units per unit of the prediction: the median ratio of distances between camera centres.

    Raises:
        InputError: all cameras stand at one place, in the world or in the prediction.
    """
    given = np.stack([camera.centre for camera in cameras])
    found = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in predicted])
    first, second = np.triu_indices(len(cameras), 1)
    ours = np.linalg.norm(given[first] - given[second], axis=1)
    theirs = np.linalg.norm(found[first] - found[second], axis=1)
    valid = (ours > 1e-9) & (theirs > 1e-9)
    if not valid.any():
        raise InputError("first points", "the cameras stand at one place, which gives no scale to predicted depth")
    return float(np.median(ours[valid] / theirs[valid]))


def fit_scale_and_shift(cameras: Sequence[Camera], depth: Float64, start: float) -> tuple[Float64, Float64]:
    """([V] scale, [V] shift) of each view's depth with which the views agree best.

    A pixel of view i at depth d lies, for view j, at a depth that is linear in d, and should be what view j says there.
    With the pixel in j held, this is a linear equation in the scales and shifts of both; the pixels are looked up anew
    each round, with a gate that closes, as in iterated closest points. Cameras side by side leave the common scale
    almost free in these equations, so the mean of the scales stays at `start` and that of the shifts at zero.

    Args:
        depth: [V,H,W]; 0 where nothing is known.
        start: the global scale to begin with.
    """
    count = len(cameras)
    scale: Float64 = np.full(count, start)
    shift: Float64 = np.zeros(count)
    for gate in np.geomspace(*_GATE, _ROUNDS):
        normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        for i in range(count):
            for j in range(count):
                if i != j:
                    rows, values = _equations(cameras, depth, (i, j), scale, shift, gate)
                    columns = [i, count + i, j, count + j]
                    normal[np.ix_(columns, columns)] += rows.T @ rows
                    right[columns] += rows.T @ values
        # The unknowns are of different size: weights are relative to what each one's votes weigh.
        prior = _PRIOR * np.maximum(np.diag(normal), 1e-12)
        right += prior * np.concatenate([scale, shift])
        normal += np.diag(prior)
        for block, mean in ((slice(0, count), start), (slice(count, None), 0.0)):
            weight = _GAUGE * np.diag(normal)[block].mean() / count
            normal[block, block] += weight
            right[block] += weight * count * mean
        solution: Float64 = np.linalg.solve(normal, right).astype(np.float64)
        scale, shift = solution[:count], solution[count:]
    return scale, shift


def _equations(
    cameras: Sequence[Camera],
    depth: Float64,
    pair: tuple[int, int],
    scale: Float64,
    shift: Float64,
    gate: float,
) -> tuple[Float64, Float64]:
    """([n,4], [n]) equations, relative to depth, in scale and shift of view i and of view j."""
    i, j = pair
    shape = depth.shape[1:]
    chosen = np.zeros(shape, np.bool_)
    chosen[::_STEP, ::_STEP] = True
    of = np.flatnonzero(chosen & (depth[i] > 0))
    mine = depth[i].ravel()[of]
    to_j = cameras[j].world_to_camera @ np.linalg.inv(cameras[i].world_to_camera)
    pixels = np.concatenate([pixel_centres(cameras[i])[of], np.ones((len(of), 1))], axis=1)
    rays = pixels @ np.linalg.inv(cameras[i].intrinsics).T @ to_j[:3, :3].T
    now = rays * (scale[i] * mine + shift[i])[:, None] + to_j[:3, 3]
    at, z = project_seen(cameras[j], now)
    good = inside(cameras[j], at, z)
    column, row = at[good].astype(np.int64).T
    there, mine, slope, z = depth[j][row, column], mine[good], rays[good, 2], z[good]
    agrees = (there > 0) & (np.abs(scale[j] * there + shift[j] - z) < gate * z)
    there, mine, slope, z = there[agrees], mine[agrees], slope[agrees], z[agrees]
    equations = np.stack([slope * mine, slope, -there, -np.ones_like(there)], axis=1) / z[:, None]
    return equations, -to_j[2, 3] / z


def project_seen(camera: Camera, seen: Float64) -> tuple[Float64, Float64]:
    """[N,3] points in `camera`'s own axes to ([N,2] pixels, [N] depth)."""
    z = seen[:, 2]
    safe = np.where(np.abs(z) < 1e-12, 1e-12, z)
    return seen[:, :2] / safe[:, None] @ camera.intrinsics[:2, :2].T + camera.intrinsics[:2, 2], z
