"""Plain 3D Gaussians, ready to splat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from streamlod.core.arrays import Float32, check_array

MAX_LOG_SCALE = 20.0  # of an anchor's size: exp stays finite in float32 whatever the bitstream says


@dataclass(frozen=True, slots=True, eq=False)
class GaussianCloud:
    """G Gaussians, all values activated.

    Attributes:
        means: [G,3] float32, world units.
        quaternions: [G,4] float32, w x y z, not necessarily of unit length.
        scales: [G,3] float32, standard deviations in world units.
        opacities: [G] float32 in [0, 1].
        colours: [G,3] float32 RGB in [0, 1].
    """

    means: Float32
    quaternions: Float32
    scales: Float32
    opacities: Float32
    colours: Float32

    def __post_init__(self) -> None:
        count = len(self.means)
        check_array("means", self.means, (None, 3), np.float32)
        check_array("quaternions", self.quaternions, (count, 4), np.float32)
        check_array("scales", self.scales, (count, 3), np.float32)
        check_array("opacities", self.opacities, (count,), np.float32)
        check_array("colours", self.colours, (count, 3), np.float32)

    def __len__(self) -> int:
        return len(self.means)


def as_cloud(*parts: NDArray[Any]) -> GaussianCloud:
    """The Gaussians of these arrays, in the order of the attributes, of any numbers that float32 can hold."""
    return GaussianCloud(*(np.ascontiguousarray(part, dtype=np.float32) for part in parts))


def concatenate(clouds: list[GaussianCloud]) -> GaussianCloud:
    """All Gaussians of `clouds` in order."""
    names = ("means", "quaternions", "scales", "opacities", "colours")
    if not clouds:
        shapes = ((0, 3), (0, 4), (0, 3), (0,), (0, 3))
        return GaussianCloud(*(np.zeros(shape, np.float32) for shape in shapes))
    return GaussianCloud(*(np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names))
