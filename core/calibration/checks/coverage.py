"""Coverage of the space: how much of it 2, 3 and 4 cameras see, and where another camera would help."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float64
from streamlod.core.calibration.checks.expected import expected
from streamlod.core.calibration.checks.finding import RigFinding, fact, fault, weak
from streamlod.core.camera import Camera

_STEPS = 21  # along each axis of the space looked at
_WIDE = 35.0  # degrees between neighbouring cameras, from which pictures between them blur
_LITTLE = 0.5  # part of the space
_ONE_PLACE = 1e-4  # of the radius looked at: nearer cameras have no picture of their own


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of a ball about the point that the rig looks at, half as wide as the cameras are away.

    Attributes:
        centre: [3] that point. radius: of the ball, in the calibration's unit.
        shares: part of the ball that at least 2, 3 and 4 cameras see.
        gaps: (degrees at the centre, numbers of two cameras) of each camera and its nearest neighbour, widest last.
    """

    centre: Float64
    radius: float
    shares: tuple[float, float, float]
    gaps: tuple[tuple[float, int, int], ...]


def coverage_of(cameras: Sequence[Camera]) -> Coverage:
    """The coverage of the space by two cameras or more."""
    centres = np.array([camera.centre for camera in cameras])
    ahead = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    # the point nearest to all lines of sight, held weakly in front of the cameras where these are parallel
    across = np.eye(3) - ahead[:, :, None] * ahead[:, None, :]
    weak = 1e-3 * np.eye(3)
    spread = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).mean()) or 1.0
    goal = (centres + 2 * spread * ahead).mean(axis=0)
    centre = np.linalg.solve(across.sum(axis=0) + weak, np.einsum("nij,nj->i", across, centres) + weak @ goal)
    if ((centre - centres) * ahead).sum(axis=1).min() <= 0:  # they look apart
        centre = goal
    radius = 0.5 * float(np.median(np.linalg.norm(centres - centre, axis=1)))
    line = np.linspace(-radius, radius, _STEPS)
    grid = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    ball = centre + grid[np.linalg.norm(grid, axis=1) <= radius]
    counts = np.sum([is_seen_by(camera, ball) for camera in cameras], axis=0)
    shares = tuple(float((counts >= least).mean()) for least in (2, 3, 4))
    rays = (centres - centre) / np.maximum(np.linalg.norm(centres - centre, axis=1, keepdims=True), 1e-12)
    angles = np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    return Coverage(centre, radius, (shares[0], shares[1], shares[2]), tuple(sorted(_tree(angles))))


def judged(coverage: Coverage, cameras: Sequence[Camera]) -> Iterator[RigFinding]:
    """Findings about what is seen, and where a camera would help most."""
    for _, a, b in coverage.gaps:
        if np.linalg.norm(cameras[a].centre - cameras[b].centre) <= _ONE_PLACE * coverage.radius:
            yield fault(f"{cameras[a].name} and {cameras[b].name} stand at one place by their poses: calibrate again")
    two, three, four = (f"{100 * share:.0f} %" for share in coverage.shares)
    yield fact(f"of the space looked at, two cameras or more see {two}, three {three}, four {four}")
    if coverage.shares[0] < _LITTLE:
        yield weak("less than half of the space is seen by two cameras: turn them to one middle, or take wider lenses")
    degrees, a, b = coverage.gaps[-1]
    names = f"{cameras[a].name} and {cameras[b].name}"
    if degrees > _WIDE:
        yield weak(f"{names} stand {degrees:.0f} degrees apart with no camera between: one there would help most")
    else:
        yield fact(f"the widest gap is of {degrees:.0f} degrees, between {names}")
    yield expected(degrees, names)


def _tree(angles: Float64) -> Iterator[tuple[float, int, int]]:
    """The narrowest edges that join all cameras."""
    joined, left = {0}, set(range(1, len(angles)))
    while left:
        degrees, a, b = min((float(angles[a, b]), a, b) for a in joined for b in left)
        joined.add(b)
        left.remove(b)
        yield degrees, a, b


def is_seen_by(camera: Camera, points: Float64) -> Bool:
    """[N] whether a camera's picture holds points [N,3]."""
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    ahead = local[:, 2] > 1e-9
    pixels = local @ camera.intrinsics.T
    pixels = pixels[:, :2] / np.where(ahead, local[:, 2], 1.0)[:, None]
    inside = (pixels >= 0).all(axis=1) & (pixels <= [camera.width, camera.height]).all(axis=1)
    return np.asarray(ahead & inside, np.bool_)
