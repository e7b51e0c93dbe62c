"""Several methods after one another: what most recordings are best served by."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from streamlod.core.frames import PointCloud
from streamlod.core.initialise.completion import Completion
from streamlod.core.initialise.method import Method, PointSources
from streamlod.core.initialise.methods.dataset import DatasetPoints
from streamlod.core.initialise.methods.learned import LearnedSweep
from streamlod.core.initialise.methods.plane_sweep import PlaneSweep
from streamlod.core.initialise.methods.random import RandomPoints

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Both:
    """The points of two methods together."""

    first: Method
    second: Method

    def find(self, sources: PointSources) -> PointCloud:
        """The points of `first`, then those of `second`."""
        return merged(self.first.find(sources), self.second.find(sources))


@dataclass(frozen=True, slots=True)
class Automatic:
    """The data set's points with those that pictures give, and what fills the gaps between them.

    Attributes:
        sweep: finds points in the pictures of two cameras or more. last_resort: where that gives too few.
        completion: fills the gaps that both leave.
        few: points; fewer are no start.
    """

    sweep: Method = field(default_factory=LearnedSweep)
    last_resort: Method = field(default_factory=RandomPoints)
    completion: Completion = field(default_factory=Completion)
    few: int = 500

    def find(self, sources: PointSources) -> PointCloud:
        """Whatever can be had."""
        points = sources.dataset_points or PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
        several = sources.frame.present.sum() > 1
        if several:
            points = merged(points, self.sweep.find(sources))
        if len(points) < self.few:
            doubt = "; are the cameras where their poses say? `streamlod check` tells" if several else ""
            _log.warning("the pictures gave only %d first points%s", len(points), doubt)
            points = merged(points, self.last_resort.find(sources))
        return self.completion.completed(points, sources.views(self.completion.rows))


def merged(first: PointCloud, second: PointCloud) -> PointCloud:
    """The points of both clouds."""
    return PointCloud(
        np.concatenate([first.positions, second.positions]), np.concatenate([first.colours, second.colours])
    )


METHODS = {"auto": Automatic(), "colmap+sweep": Both(DatasetPoints(), PlaneSweep())}
