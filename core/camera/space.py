"""The space in which a rig's recording is trained: independent of the calibration's unit, origin and axes.

Coordinates of a calibration may be metres, millimetres or what a reconstruction came to, and their origin may lie in
another country. Training, the bitstream and viewers work with 32-bit numbers, a near plane and prices that have a unit.
So cameras and points are brought into a space whose origin is amid the cameras, whose axes are the rig's (x right,
y down, z ahead), and in which the rig looks at things that are `VIEWING_DISTANCE` away. It is computed in 64 bits from
the cameras alone.

Poses there are rounded to a coarser grid than 64 bits have. Two calibrations of one rig, in other units or far from
the origin, then give the same numbers to the last bit, as far as theirs agree; training would make two streams of
numbers that differ in one, as it does with another seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera.camera import Camera

VIEWING_DISTANCE = 4.0  # what rigs of a few metres have: prices and planes of the method were chosen with these
_GRID = 2.0**-20  # a thousandth of a pixel in pictures of 4K; coordinates of 1e7 metres are rounded to 2e-9
_NEAREST, _FARTHEST = 0.25, 3.0  # a viewing distance is believed between these multiples of the rig's width
_PARALLEL = 1e6  # condition number from which optical axes do not meet
_LIKE_MEAN = 1e-6  # weight of the mean of the cameras' down axes, against the spread of their right sides
_SHORT = 0.1  # a mean of unit vectors that is shorter says no direction
_ONE_PLACE = 1e-13  # of the coordinates: what is narrower than this is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """A change of coordinates without distortion: x becomes ``scale * rotation @ (x - origin)``.

    Attributes:
        scale: new units in an old one, above 0.
        rotation: [3,3] float64.
        origin: [3] float64, in old coordinates.
        grid: poses of cameras and depths become multiples of it; 0 leaves them as they are.
    """

    scale: float
    rotation: Float64
    origin: Float64
    grid: float = 0.0

    def positions(self, old: Float64) -> Float64:
        """[N,3] positions in the new coordinates; not finite where the old ones are not, or are too large."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self._positions(old)

    def _positions(self, old: Float64) -> Float64:
        return np.asarray(self.scale * (old - self.origin) @ self.rotation.T, np.float64)

    def camera(self, old: Camera) -> Camera:
        """The camera at its new place."""
        pose = old.world_to_camera.copy()
        pose[:3, 3] = self.scale * (old.world_to_camera[:3, :3] @ self.origin + old.world_to_camera[:3, 3])
        pose[:3, :3] = old.world_to_camera[:3, :3] @ self.rotation.T
        return replace(old, world_to_camera=self._rounded(pose))

    def depths(self, old: tuple[float, float]) -> tuple[float, float]:
        """Nearest and farthest depth in the new units."""
        near, far = np.maximum(self._rounded(self.scale * np.array(old)), self.grid)
        return float(near), float(far)

    def _rounded(self, numbers: Float64) -> Float64:
        return numbers if self.grid == 0 else np.round(numbers / self.grid) * self.grid + 0.0  # no zero is negative

    def to_json(self) -> dict[str, object]:
        """Plain values of the transform."""
        return {"scale": self.scale, "rotation": self.rotation.tolist(), "origin": self.origin.tolist()}

    def inverse(self) -> Similarity:
        """The inverse transform."""
        return Similarity(1 / self.scale, self.rotation.T, -self.scale * self.rotation @ self.origin)

    def after(self, first: Similarity) -> Similarity:
        """Both changes in one: `first`, then this one."""
        origin = first.origin + first.rotation.T @ self.origin / first.scale
        grid = max(self.grid, first.grid)
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, origin, grid)


UNCHANGED = Similarity(1.0, np.eye(3), np.zeros(3))


def training_space(cameras: Sequence[Camera], depth_bounds: tuple[float, float] | None = None) -> Similarity:
    """From a calibration's coordinates to those of training.

    Args:
        cameras: all of the calibration, whichever are used, so that all who read it come to the same space.
        depth_bounds: (near, far) of the scene; used where all cameras stand at one place, which says nothing of scale.
    """
    centres = _centres(cameras)
    origin = centres.mean(axis=0)
    distance = _viewing_distance(centres - origin, _forwards(cameras), float(np.abs(centres).max()))
    if distance is None:
        distance = VIEWING_DISTANCE if depth_bounds is None else float(np.sqrt(depth_bounds[0] * depth_bounds[1]))
    return Similarity(VIEWING_DISTANCE / distance, _axes(cameras), origin, _GRID)


def space_of(cameras: Sequence[Camera], wanted: Sequence[Camera]) -> Similarity | None:
    """The transform that brings `cameras` to where `wanted` has those of the same names.

    None where fewer than two that stand apart are in both.
    """
    by_name = {camera.name: camera for camera in wanted}
    pairs = [(camera, by_name[camera.name]) for camera in cameras if camera.name in by_name]
    if len(pairs) < 2:
        return None
    ours, theirs = (_centres(side) for side in zip(*pairs, strict=True))
    here, there = ours.mean(axis=0), theirs.mean(axis=0)
    spread, wanted_spread = (float(np.linalg.norm(c - c.mean(axis=0))) for c in (ours, theirs))
    if spread <= _ONE_PLACE * np.abs(ours).max() or wanted_spread <= _ONE_PLACE * np.abs(theirs).max():
        return None
    turns = sum(b.world_to_camera[:3, :3].T @ a.world_to_camera[:3, :3] for a, b in pairs)
    left, _, right = np.linalg.svd(turns)
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    scale = wanted_spread / spread
    return Similarity(scale, rotation, here - rotation.T @ there / scale)


def _centres(cameras: Sequence[Camera]) -> Float64:
    """[C,3] camera centres; exact also where a rotation that was written with few digits is not quite one."""
    return np.stack([np.linalg.solve(c.world_to_camera[:3, :3], -c.world_to_camera[:3, 3]) for c in cameras])


def _forwards(cameras: Sequence[Camera]) -> Float64:
    return np.stack([camera.world_to_camera[2, :3] for camera in cameras])


def _axes(cameras: Sequence[Camera]) -> Float64:
    """[3,3] rows: right, down, ahead. Down is level with the cameras' right sides, whose pitch says nothing of it."""
    rights, downs, forwards = (np.stack([c.world_to_camera[row, :3] for c in cameras]) for row in range(3))
    usual = _first_long([downs.mean(axis=0), downs[0]])
    level = rights.T @ rights / len(cameras)
    _, directions = np.linalg.eigh(level + _LIKE_MEAN * (np.eye(3) - np.outer(usual, usual)))
    down = directions[:, 0] * np.sign(directions[:, 0] @ usual)
    ahead = _first_long([d - (d @ down) * down for d in (forwards.mean(axis=0), forwards[0], -downs[0])])
    return np.stack([np.cross(down, ahead), down, ahead])


def _first_long(vectors: Sequence[Float64]) -> Float64:
    """The first of `vectors` that says a direction, or the last, of length 1."""
    lengths = [float(np.linalg.norm(vector)) for vector in vectors]
    chosen = next((n for n, length in enumerate(lengths) if length > _SHORT), len(vectors) - 1)
    return np.asarray(vectors[chosen] / lengths[chosen], np.float64)


def _viewing_distance(centres: Float64, forwards: Float64, largest: float) -> float | None:
    """The median depth of the point nearest to all optical axes, as far as the rig's width makes it likely.

    Args:
        largest: coordinate from which the centres were computed, a measure of their rounding.

    Returns:
        None where all cameras stand at one place.
    """
    width = float(np.linalg.norm(centres[:, None] - centres[None], axis=2).max())
    if width <= _ONE_PLACE * largest:
        return None
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    matrix = across.sum(axis=0)
    depth = 0.0
    if np.linalg.cond(matrix) < _PARALLEL:
        focus = np.linalg.solve(matrix, (across @ centres[:, :, None]).sum(axis=0)[:, 0])
        depth = float(np.median(((focus - centres) * forwards).sum(axis=1)))
    if depth <= 0:  # axes that are parallel, or meet behind the cameras
        return _FARTHEST * width
    return min(max(depth, _NEAREST * width), _FARTHEST * width)
