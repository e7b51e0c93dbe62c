"""How near and how far a rig can see in stereo, when nobody has said how deep the scene is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.initialise.consistency import Trust, trusted
from streamlod.core.initialise.equalise import with_equal_means
from streamlod.core.initialise.stereo.sweep import DepthMap, sweep_views
from streamlod.core.initialise.views import WorkingViews, inside, project, unproject

COARSE_HEIGHT, COARSE_PLANES = 120, 96
_COARSE = Trust(tolerance=0.05, cost_by_one=0.6)
_GRID = 8  # rays a side that stand for a picture
_PARALLAX = 1.5 / 240  # of a picture's height: less parallax against infinity than this tells nothing
_SEARCH = (1e-2, 1e3, 101)  # depths tried, in units of the rig's width
_ENOUGH = 200  # trusted pixels that make the coarse depths worth believing
_QUANTILES, _MARGINS = (0.005, 0.995), (0.8, 1.3)


def estimate_bounds(views: WorkingViews) -> tuple[float, float]:
    """(near, far) depth of the scene in world units: from the rig's geometry, then narrowed by a coarse plane sweep.

    Raises:
        InputError: all cameras stand at one place, or no two of them see the same space.
    """
    widest = geometric_bounds(views.cameras)
    return narrowed(widest, sweep_views(with_equal_means(views.resized(COARSE_HEIGHT)), widest, COARSE_PLANES))


def narrowed(widest: tuple[float, float], maps: Sequence[DepthMap]) -> tuple[float, float]:
    """`widest` as far as coarse depth `maps` show that it is needed."""
    depth = np.concatenate([_trusted_depth(index, maps) for index in range(len(maps))])
    if len(depth) < _ENOUGH:
        return widest
    near, far = (m * q for m, q in zip(_MARGINS, np.quantile(depth, _QUANTILES), strict=True))
    return max(float(near), widest[0]), min(float(far), widest[1])


def geometric_bounds(cameras: Sequence[Camera]) -> tuple[float, float]:
    """(near, far) depth in world units between which a rig can measure at all.

    Near: half the rays of half the cameras are seen by another camera. Far: the parallax between neighbours, against
    infinity, is a pixel and a half of 240. Holds for rigs that look forward and for rigs that look inward.

    Raises:
        InputError: all cameras stand at one place, or no two of them see the same space.
    """
    centres = np.stack([camera.centre for camera in cameras])
    between = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    width = rig_width(cameras)
    depths = width * np.geomspace(*_SEARCH)
    shared = np.array([np.median([_shared(cameras, index, d) for index in range(len(cameras))]) for d in depths])
    if shared.max() <= 0:
        raise InputError("cameras", "no two of them see the same space; check the poses")
    near = float(depths[np.argmax(shared >= 0.5 * min(1.0, 2 * shared.max()))])
    between[between <= 1e-6 * width] = np.inf  # a camera is not its own neighbour
    focal = np.median([camera.intrinsics[1, 1] / camera.height for camera in cameras])
    far = float(np.median(between.min(axis=1)) * focal / _PARALLAX)
    return near, max(far, 4 * near)


def rig_width(cameras: Sequence[Camera]) -> float:
    """The largest distance between two cameras, in world units.

    Raises:
        InputError: all cameras stand at one place.
    """
    centres = np.stack([camera.centre for camera in cameras])
    width = float(np.linalg.norm(centres[:, None] - centres[None], axis=2).max())
    if width <= 0:
        raise InputError(
            "cameras", "at least two of them must stand at different places to find depth; use a points file or random"
        )
    return width


def _shared(cameras: Sequence[Camera], index: int, depth: float) -> float:
    """The fraction of camera `index`'s picture that another camera also sees, from the same side, at `depth`."""
    camera = cameras[index]
    steps = (np.arange(_GRID) + 0.5) / _GRID
    pixels = np.stack(np.meshgrid(steps * camera.width, steps * camera.height), axis=-1).reshape(-1, 2)
    points = unproject(camera, pixels, np.full(len(pixels), depth))
    axis = camera.world_to_camera[2, :3]
    seen = np.zeros(len(points), np.bool_)
    for other in cameras:
        if other is not camera and other.world_to_camera[2, :3] @ axis > 0:
            seen |= inside(other, *project(other, points))
    return float(seen.mean())


def _trusted_depth(index: int, maps: Sequence[DepthMap]) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    """[n] depths of map `index` that other views confirm."""
    return maps[index].depth.ravel()[trusted(maps[index].points(), index, maps, _COARSE)]
