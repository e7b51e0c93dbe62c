"""Cameras that pictures are made to fit, in a space of choice, and the points that came with them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from streamlod.core.camera import Camera
from streamlod.core.camera.space import Similarity
from streamlod.core.data.lens import Undistortion
from streamlod.core.data.names import listed
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud


class CalibrationFile(Protocol):
    """Files that cameras were read from, and what came with them."""

    @property
    def path(self) -> Path:
        """The file or folder, for messages."""

    @property
    def depth_bounds(self) -> tuple[float, float] | None:
        """Nearest and farthest depth of the scene in the calibration's units, if known."""

    @property
    def read_points(self) -> Callable[[Similarity], PointCloud] | None:
        """Reads the points that came with it into a space; None without points."""


class PlacedCameras(ABC):
    """Cameras without distortion, at the size wanted and in a space.

    Attributes:
        undistortions: what makes a raw picture fit the camera, for each camera used here.
        space: leads from the calibration's coordinates to those of `cameras`, points and depth bounds.
        cameras: pinholes that match the pictures; a subclass holds `placed_cameras` there.
    """

    __slots__ = ()
    undistortions: tuple[Undistortion, ...]
    space: Similarity
    cameras: tuple[Camera, ...]

    @property
    @abstractmethod
    def calibration(self) -> CalibrationFile:
        """Where the cameras come from."""

    @property
    def calibrated(self) -> tuple[Camera, ...]:
        """The cameras in the calibration's own coordinates."""
        return tuple(plan.camera for plan in self.undistortions)

    @property
    def placed_cameras(self) -> tuple[Camera, ...]:
        """The cameras in the space."""
        return tuple(self.space.camera(camera) for camera in self.calibrated)

    @property
    def upright(self) -> tuple[Camera, ...]:
        """The cameras as they stood: where pictures are turned to lie like others', before that."""
        return tuple(self.space.camera(plan.upright) for plan in self.undistortions)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def depth_bounds(self) -> tuple[float, float] | None:
        """Nearest and farthest depth of the scene in units of the space, if known."""
        bounds = self.calibration.depth_bounds
        return None if bounds is None else self.space.depths(bounds)

    def points(self) -> PointCloud | None:
        """The points that came with the calibration, or none; InputError if their file is damaged."""
        read = self.calibration.read_points
        return None if read is None else read(self.space)

    def rows_of(self, names: Sequence[str]) -> tuple[int, ...]:
        """Numbers here of the cameras `names`, in that order.

        Raises:
            InputError: a name that does not exist, or given twice.
        """
        rows = tuple(row_of(name, self.names, self.calibration.path) for name in names)
        if not rows or len(set(rows)) < len(rows):
            raise InputError(self.calibration.path, "needs at least one camera selected, and each only once")
        return rows


def row_of(name: str, names: Sequence[str], path: Path) -> int:
    """The number of a camera among those of `path`; InputError for a name that is not there."""
    if name not in names:
        raise InputError(path, f"has no camera {name!r:.80}; it has {listed(names)}")
    return names.index(name)
