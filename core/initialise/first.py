"""The choice between the ways to first points."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.camera.space import UNCHANGED, Similarity
from streamlod.core.errors import InputError, ModelError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise.method import Method, PointSources
from streamlod.core.initialise.methods import known_methods
from streamlod.core.initialise.plugins import PLUGINS, load
from streamlod.core.initialise.points_file import SUFFIXES, read_points

_KNOWN = known_methods()
METHODS = (*_KNOWN, *PLUGINS)
_log = logging.getLogger(__name__)


def first_points(
    frame: FrameSet,
    cameras: Sequence[Camera],
    *,
    depth_bounds: tuple[float, float] | None,
    method: str | Method = "auto",
    dataset_points: PointCloud | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    space: Similarity = UNCHANGED,
) -> PointCloud:
    """Points to start the first frame from.

    Args:
        frame: one instant; cameras that are not present are left out.
        cameras: [C] pinholes, in the order of the pictures and of their size.
        depth_bounds: (near, far) in world units, or None to estimate them.
        method: one of `METHODS`, the path of a ``.ply`` or ``.npz`` file of points, or a method itself. ``auto`` takes
            depths of the pictures together with the data set's points, and random points where these give too few.
        dataset_points: what the data set itself has, for ``colmap`` and ``auto``.
        seed: of random points.
        progress: called with the fraction done, from 0 to 1.
        space: of the cameras, as seen from the coordinates of a file of points.

    Raises:
        InputError: unknown method, unusable file, bounds or cameras, or points that the data set does not have.
        ModelError: the method found no points.
        BackendUnavailable: a package or a model that the method needs is missing.
    """
    report = progress or (lambda _: None)
    if depth_bounds is not None and not 0 < depth_bounds[0] < depth_bounds[1] < np.inf:
        raise InputError("depth bounds", f"near and far must be positive and in order, not {depth_bounds}")
    if isinstance(method, str) and method not in METHODS:
        if Path(method).suffix.lower() not in SUFFIXES:
            names = ", ".join(METHODS)
            raise InputError("first points", f"{method!r} is neither one of {names} nor a .ply or .npz file")
        points = read_points(Path(method), space)
    else:
        finder = method
        if isinstance(finder, str):
            finder = load(finder) if finder in PLUGINS else _KNOWN[finder]
        points = finder(PointSources(frame, cameras, depth_bounds, dataset_points, seed, report))
    if len(points) == 0:
        raise ModelError(f"first points by {method}: none were found; try random or a points file")
    report(1.0)
    _log.info("%d first points by %s", len(points), method)
    return points
