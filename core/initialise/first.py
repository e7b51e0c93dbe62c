"""The choice between the ways to first points."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from core.camera import Camera
from core.errors import InputError, ModelError
from core.frames import FrameSet, PointCloud
from core.initialise.bounds import estimate_bounds
from core.initialise.consistency import consistent_points
from core.initialise.points_file import SUFFIXES, read_points
from core.initialise.scatter import random_points
from core.initialise.sweep import sweep_views
from core.initialise.views import Views, working_views

METHODS = ("auto", "colmap", "sweep", "colmap+sweep", "vggt", "random")
_HEIGHT = 240  # rows at which depth is measured
_VGGT_HEIGHT = 518  # rows at which VGGT looks
_FEW = 500  # fewer points than this are no start
_log = logging.getLogger(__name__)


def first_points(
    frame: FrameSet,
    cameras: Sequence[Camera],
    *,
    depth_bounds: tuple[float, float] | None,
    method: str = "auto",
    dataset_points: PointCloud | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> PointCloud:
    """Points to start the first frame from.

    Args:
        frame: one instant; cameras that are not present are left out.
        cameras: [C] pinholes, in the order of the pictures and of their size.
        depth_bounds: (near, far) in world units, or None to estimate them.
        method: one of `METHODS`, or the path of a ``.ply`` or ``.npz`` file of points. ``auto`` takes the plane sweep
            together with the data set's points, and random points where the pictures give too few.
        dataset_points: what the data set itself has, for ``colmap`` and ``auto``.
        seed: of random points.
        progress: called with the fraction done, from 0 to 1.

    Raises:
        InputError: unknown method, unusable file, bounds or cameras, or points that the data set does not have.
        ModelError: the method found no points.
        BackendUnavailable: VGGT is not installed.
    """
    report = progress or (lambda _: None)
    if depth_bounds is not None and not 0 < depth_bounds[0] < depth_bounds[1] < np.inf:
        raise InputError("depth bounds", f"near and far must be positive and in order, not {depth_bounds}")
    views = working_views(frame, cameras, _HEIGHT)
    if method == "auto":
        points = _best(views, depth_bounds, dataset_points, seed, report)
    elif method == "colmap":
        points = _required(dataset_points)
    elif method == "sweep":
        points = swept_points(views, depth_bounds, report)
    elif method == "colmap+sweep":
        points = merged(_required(dataset_points), swept_points(views, depth_bounds, report))
    elif method == "vggt":
        from core.initialise.vggt import vggt_points  # its package is optional

        points = vggt_points(working_views(frame, cameras, _VGGT_HEIGHT))
    elif method == "random":
        points = random_points(views, depth_bounds or estimate_bounds(views), seed)
    elif Path(method).suffix.lower() in SUFFIXES:
        points = read_points(Path(method))
    else:
        raise InputError("first points", f"{method!r} is neither one of {', '.join(METHODS)} nor a .ply or .npz file")
    if len(points) == 0:
        raise ModelError(f"first points by {method}: none were found; try random or a points file")
    report(1.0)
    _log.info("%d first points by %s", len(points), method)
    return points


def swept_points(
    views: Views, depth_bounds: tuple[float, float] | None, progress: Callable[[float], None] | None = None
) -> PointCloud:
    """Points by plane sweep and cross-view consistency; possibly none.

    Raises:
        InputError: fewer than two views, or a rig that cannot measure depth.
    """
    if len(views) < 2:
        raise InputError("plane sweep", "needs pictures of at least two cameras; use a points file or random")
    bounds = depth_bounds or estimate_bounds(views)
    return consistent_points(views, sweep_views(views, bounds, progress=progress))


def merged(first: PointCloud, second: PointCloud) -> PointCloud:
    """The points of both clouds."""
    return PointCloud(
        np.concatenate([first.positions, second.positions]), np.concatenate([first.colours, second.colours])
    )


def _best(
    views: Views,
    depth_bounds: tuple[float, float] | None,
    dataset_points: PointCloud | None,
    seed: int,
    progress: Callable[[float], None],
) -> PointCloud:
    """What `auto` means."""
    known = dataset_points or PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    points = known
    if len(views) > 1:
        points = merged(known, swept_points(views, depth_bounds, progress))
    if len(points) >= _FEW:
        return points
    _log.warning("the pictures gave only %d first points", len(points))
    bounds = depth_bounds or (estimate_bounds(views) if len(views) > 1 else None)
    if bounds is None:
        raise InputError("first points", "one camera alone gives no depth: name a points file or depth bounds")
    return merged(points, random_points(views, bounds, seed))


def _required(points: PointCloud | None) -> PointCloud:
    if points is None:
        raise InputError("first points", "the data set has none of its own: choose sweep, random or a points file")
    return points
