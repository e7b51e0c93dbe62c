"""From pictures of several instants to calibrated cameras.

A camera that stands still is one image, whose features are those of all instants; of two cameras, only features of one
instant are compared. So moving things give features as still ones do, and more than one picture a camera would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.checks.matches import Features
from streamlod.core.calibration.features.mapping import mapped
from streamlod.core.calibration.trust import check_lens
from streamlod.core.calibration.walk import WalkFootage
from streamlod.core.calibration.world import axes_of, up_of
from streamlod.core.camera import Camera
from streamlod.core.data.lens import opencv_camera

_LOWEST = 0.02  # part of the points that may lie below the floor, being wrong
_DISTANCE = 3.0  # units of cameras from what they see, where no length is known
_ADVICE = (
    "what it shares with the others; keep a known one with --lenses, put a camera between it and the next, or walk a "
    "board"
)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureCalibration:
    """A rig calibrated from features.

    Attributes:
        cameras: world to camera, z up, in metres where a length was known.
        offsets: [C] seconds to add to each camera's clock, as was known before: features tell none.
        periods: [C] seconds between each camera's pictures.
        points: [P,3] features in the world.
        counts: [C] features that place each camera.
        misses: [C] pixels by which they miss, root mean square.
    """

    cameras: tuple[Camera, ...]
    offsets: Float64
    periods: Float64
    points: Float64
    counts: tuple[int, ...]
    misses: Float64

    def rms(self, camera: int) -> float:
        """Root mean square of what one camera's features miss, in pixels."""
        return float(self.misses[camera])

    def apart(self, one: str, other: str) -> float:
        """Units between two cameras of these names."""
        centres = {camera.name: camera.centre for camera in self.cameras}
        return float(np.linalg.norm(centres[one] - centres[other]))

    def scaled(self, factor: float) -> FeatureCalibration:
        """The same in units that are so many times smaller."""
        cameras = []
        for camera in self.cameras:
            pose = camera.world_to_camera.copy()
            pose[:3, 3] *= factor
            cameras.append(replace(camera, world_to_camera=pose))
        return replace(self, cameras=tuple(cameras), points=self.points * factor)


def calibrate_by_features(
    footage: Sequence[WalkFootage],
    features: Sequence[Sequence[Features]],
    offsets: Float64,
    known: Mapping[str, Float64],
    on_step: Callable[[], object],
) -> FeatureCalibration:
    """The rig whose cameras saw `features`, a list of instants of each, z up as the cameras are held.

    Lengths are in units of a third of the cameras' distance from what they see.

    Args:
        offsets: [C] seconds from each camera's clock to that of these instants.
        known: lenses [9] by camera that are kept. on_step: called as the work goes on, see `mapping.mapped`.

    Raises:
        InputError: cameras that share too little with the others, or whose lens does not follow from it, named.
        BackendUnavailable: pycolmap is missing.
    """
    found, points = mapped([each.camera for each in footage], [each.size for each in footage], features, known, on_step)
    poses = np.array([camera.pose for camera in found])
    to_world = _to_world(poses, points)
    placed = rigid.after(poses, rigid.inverse(to_world))
    rig = FeatureCalibration(
        tuple(
            opencv_camera(each.camera, camera.matrix, rigid.matrix(pose), each.size, camera.distortion)
            for each, camera, pose in zip(footage, found, placed, strict=True)
        ),
        offsets,
        np.array([each.period for each in footage]),
        points @ rigid.rotations(to_world[:3])[0].T + to_world[3:],
        tuple(camera.count for camera in found),
        np.array([camera.miss for camera in found]),
    )
    for camera in rig.cameras:
        check_lens(camera, _ADVICE)
    centres = np.array([camera.centre for camera in rig.cameras])
    return rig.scaled(_DISTANCE / float(np.median(np.linalg.norm(centres - np.median(rig.points, axis=0), axis=1))))


def _to_world(cameras: Float64, points: Float64) -> Float64:
    """[6] to axes whose z is up, and 0 where the lowest points are."""
    up, middle = up_of(cameras), np.median(points, axis=0)
    lowest = float(np.quantile(points @ up, _LOWEST))
    return axes_of(cameras, up, middle + up * (lowest - middle @ up))
