"""Planes through the pixels of a view, each an inverse depth that is linear in the pixels."""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float32, Float64


def facing(depth: Float32, limits: tuple[float, float]) -> Float64:
    """[H,W,3] planes at `depth` [H,W] that face the camera, with inverse depths within `limits`."""
    planes = np.zeros((*depth.shape, 3))
    planes[..., 0] = np.clip(1 / depth.astype(np.float64), *limits)
    return planes


def resampled(planes: Float64, size: tuple[int, int], limits: tuple[float, float]) -> Float64:
    """[H,W,3] planes of the same view in a picture of another `size` (width, height): each pixel has the nearest one.

    Args:
        planes: [h,w,3] inverse depth at each pixel, and by how much it grows a pixel to the right and a pixel down.
        limits: between which inverse depths lie.
    """
    (x, column), (y, row) = (_nearest(new, old) for new, old in zip(size, planes.shape[1::-1], strict=True))
    depth, right, down = np.moveaxis(planes[np.ix_(row, column)], 2, 0)
    here = depth + right * (x - column) + down * (y - row)[:, None]
    scale = planes.shape[1] / size[0], planes.shape[0] / size[1]
    return np.stack([here.clip(*limits), right * scale[0], down * scale[1]], axis=2)


def _nearest(new: int, old: int) -> tuple[Float64, np.ndarray[tuple[int], np.dtype[np.intp]]]:
    """Where the centres of `new` pixels lie among `old` ones, and which of these are nearest."""
    place = (np.arange(new) + 0.5) * old / new - 0.5
    return place, np.clip(np.round(place), 0, old - 1).astype(np.intp)
