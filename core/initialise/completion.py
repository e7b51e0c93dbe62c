"""Points where no depth could be told: on the smoothest surface between those whose depth is known.

A picture of points alone has holes. Inverse depths are spread from known pixels into the gaps as heat spreads in a
plate, slower across edges of the picture (a Dirichlet problem; weights after Levin et al. 2004). Between known pixels
of a plane lies that plane, and no depth leaves the range of the known ones.

A first picture, which nothing trains, is filled so. Before training it costs more than it gives: what each camera alone
is given lies at a wrong depth, and hides the scene from viewers between (docs/history/deleted.md). Unless cameras share
so little that most of their pictures would stay without points: then what one of them alone looks at is filled.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from streamlod.core.arrays import Bool, Float32, Float64
from streamlod.core.camera import Camera
from streamlod.core.camera.beside import views_between
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.views import WorkingViews, inside, pixel_centres, project, unproject

_EDGE = 0.08  # difference of colours, in [0, 1], across which depths spread e times slower
_LEAST = 0.02  # of the weight within one colour, that depths spread with across any edge
_SURE = 1e3  # weight of a known depth, in neighbours of the same colour
_SHARES = (0.25, 0.5)  # of the way from each camera to its neighbours: views from which nothing is hidden
_BEFORE = 0.05  # relative depth by which a point before a view's known surface hides it


def completed(points: PointCloud, views: WorkingViews, *, alone: bool = False) -> PointCloud:
    """`points`, and further ones in the gaps that they leave in the small pictures of `views`, coloured by these.

    Each pixel of a gap gets a point; one with a known point, or beside one, is no gap. Views are completed one after
    the other: nothing is filled twice. A point that would hide what `points` show another view is left out.

    Args:
        alone: whether only those are kept that no other view looks at, and that hide nothing from views on the way from
            each to its neighbours.
    """
    between = views_between(views.cameras, _SHARES) if alone else []
    known = [(view, nearest_depths(points.positions, view)) for view in (*views.cameras, *between)]
    found = points
    for number, camera in enumerate(views.cameras):
        measured, filled = known[number][1], nearest_depths(found.positions, camera)
        sure = measured if np.isfinite(measured).any() else filled
        if not np.isfinite(sure).any():
            continue  # nothing says how deep this view is
        new = in_gaps(spread(sure, views.images[number]), filled, camera, views.images[number])
        kept = np.ones(len(new.positions), np.bool_)
        for other, depths_there in known[:number] + known[number + 1 :]:
            kept &= ~hides(new.positions, other, depths_there)
        for other in (*views.cameras[:number], *views.cameras[number + 1 :]) if alone else ():
            kept &= ~inside(other, *project(other, new.positions.astype(np.float64)))
        found = PointCloud(
            np.concatenate([found.positions, new.positions[kept]]),
            np.concatenate([found.colours, new.colours[kept]]),
        )
    return found


def share_of_gaps(points: PointCloud, views: WorkingViews) -> float:
    """Part of a picture that lies in gaps which `points` leave, for the one of `views` that has fewest."""
    return float(np.min([_gaps(nearest_depths(points.positions, view)).mean() for view in views.cameras]))


def in_gaps(inverse: Float64, depths: Float64, camera: Camera, image: Float32) -> PointCloud:
    """Points at `inverse` depths [H,W] in the pixels of `image` [H,W,3] round which no depth of `depths` is finite."""
    gap = _gaps(depths)
    positions = unproject(camera, pixel_centres(camera)[gap.ravel()], 1 / inverse[gap])
    return PointCloud(positions.astype(np.float32), image[gap])


def _gaps(depths: Float64) -> Bool:
    """[H,W] pixels round which no depth of `depths` is finite."""
    return np.asarray(cv2.dilate(np.isfinite(depths).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)


def nearest_depths(positions: Float32, camera: Camera) -> Float64:
    """[H,W] depth of the nearest of `positions` [N,3] in each pixel of `camera`, infinite where there is none."""
    depths = np.full((camera.height, camera.width), np.inf)
    pixels, depth = project(camera, positions.astype(np.float64))
    seen = inside(camera, pixels, depth)
    column, row = pixels[seen].astype(np.int64).T
    np.minimum.at(depths, (row, column), depth[seen])
    return depths


def spread(depths: Float64, image: Float32) -> Float64:
    """[H,W] inverse depth of every pixel, from those of finite `depths` [H,W], of which there must be one.

    Solves for the inverse depths that differ least between neighbours, these weighted by how alike their colours in
    `image` [H,W,3] are.
    """
    known: Bool = np.isfinite(depths)
    count, number = depths.size, np.arange(depths.size).reshape(depths.shape)
    firsts, seconds, weights = [], [], []
    for before, after in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        difference = np.abs(image[before] - image[after]).max(axis=2)
        firsts.append(number[before].ravel())
        seconds.append(number[after].ravel())
        weights.append((np.exp(-difference / _EDGE) + _LEAST).ravel().astype(np.float64))
    first, second, weight = np.concatenate(firsts), np.concatenate(seconds), np.concatenate(weights)
    sure = _SURE * known.ravel()
    own = sure + np.bincount(first, weight, count) + np.bincount(second, weight, count)
    every = np.arange(count)
    system = coo_matrix(
        (np.concatenate([own, -weight, -weight]), (np.r_[every, first, second], np.r_[every, second, first]))
    )
    values = np.where(known, 1 / np.where(known, depths, 1.0), 0.0)
    return np.asarray(spsolve(system.tocsc(), sure * values.ravel()), np.float64).reshape(depths.shape)


def hides(positions: Float32, camera: Camera, depths: Float64) -> Bool:
    """[N] which of `positions` [N,3] lie before the finite `depths` [H,W] that `camera` knows in their pixels."""
    pixels, depth = project(camera, positions.astype(np.float64))
    seen = inside(camera, pixels, depth)
    column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
    there = depths[row, column]
    return np.asarray(seen & np.isfinite(there) & (depth < there * (1 - _BEFORE)), np.bool_)
