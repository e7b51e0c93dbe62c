"""The points that the data set itself has, for example of structure from motion."""

from __future__ import annotations

from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from streamlod.core.initialise.method import PointSources


def dataset_points(sources: PointSources) -> PointCloud:
    """The data set's own points as they are.

    Raises:
        InputError: the data set has none.
    """
    if sources.dataset_points is None:
        raise InputError("first points", "the data set has none of its own: choose sweep, random or a points file")
    return sources.dataset_points


METHODS = {"colmap": dataset_points}
