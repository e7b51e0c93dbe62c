"""The description of a synthetic clip and of the rig that films it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.errors import InputError
from streamlod.core.synthetic.kind import CameraArc, Kind
from streamlod.core.synthetic.kinds import KINDS

_MAX_PIXELS = 4096 * 4096
_DRIFT_SECONDS = 8.0  # in which exposures drift up, down and back


@dataclass(frozen=True, slots=True)
class SyntheticSpec:
    """A clip of a synthetic place; two equal specs give equal pictures.

    Attributes:
        cameras: number of cameras, 1 to 64.
        frames: number of frames.
        width, height: picture size in pixels.
        seed: of the textures, the arrangement and the noise.
        noise: standard deviation of the camera noise in grey levels of 255.
        exposure_spread: standard deviation of the cameras' exposures in stops; cam00 has the nominal one.
        exposure_drift: standard deviation of how far they drift away from that in stops, and back, as automatic ones
            do; cam00's stays.
        still: whether nothing moves (the noise still does).
        fps: frames a second.
        kind: the place, a name in `kinds.KINDS`.
        speed: pixels a frame of the fastest thing at the target's distance, at its start; 0 for the kind's own pace.

    Raises:
        InputError: a number out of range.
    """

    cameras: int = 13
    frames: int = 60
    width: int = 480
    height: int = 270
    seed: int = 0
    noise: float = 1.0
    exposure_spread: float = 0.0
    exposure_drift: float = 0.0
    still: bool = False
    fps: float = 30.0
    kind: str = "room"
    speed: float = 0.0

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("cameras", self.cameras, 1, 64),
            ("frames", self.frames, 1, 1_000_000),
            ("width", self.width, 16, 8192),
            ("height", self.height, 16, 8192),
            ("seed", self.seed, 0, 2**31 - 1),
            ("noise", self.noise, 0.0, 100.0),
            ("exposure_spread", self.exposure_spread, 0.0, 4.0),
            ("exposure_drift", self.exposure_drift, 0.0, 4.0),
            ("fps", self.fps, 1e-3, 1000.0),
            ("speed", self.speed, 0.0, 100.0),
        ):
            if not low <= value <= high:
                raise InputError("synthetic clip", f"{name} must lie in {low} to {high}, not {value}")
        if self.kind not in KINDS:
            raise InputError("synthetic clip", f"kind must be one of {', '.join(KINDS)}, not {self.kind!r}")
        if self.width * self.height > _MAX_PIXELS:
            raise InputError("synthetic clip", f"{self.width}x{self.height} pictures have more than 2^24 pixels")

    def time_of(self, index: int) -> float:
        """Scene time of frame `index` in seconds; a still clip stays at 0."""
        return 0.0 if self.still else index / self._rate

    @property
    def cycle(self) -> float:
        """Seconds of scene time in which what comes and goes does so once: the clip, but 0.6 to 4 seconds."""
        return min(max(self.frames / self._rate, 0.6), 4.0)

    @property
    def place(self) -> Kind:
        """The place that is filmed."""
        return KINDS[self.kind]

    @property
    def _rate(self) -> float:
        """Frames in a second of scene time."""
        if self.speed == 0.0:
            return self.fps
        rig = self.place.rig
        return rig.focal * self.width * self.place.metres_per_second / (self.speed * rig.radius)


@lru_cache(maxsize=16)
def cameras(spec: SyntheticSpec) -> tuple[Camera, ...]:
    """The rig: cam00 in the middle, the others from left to right on an arc, alternately low and high."""
    rig, others = spec.place.rig, spec.cameras - 1
    turns = np.linspace(-1.0, 1.0, others) if others > 1 else np.ones(others)
    places = [_eye(rig, 0.0, sum(rig.heights) / 2)]
    places += [_eye(rig, float(turn), rig.heights[i % 2]) for i, turn in enumerate(turns)]
    focal = rig.focal * spec.width
    size, principal = (spec.width, spec.height), (spec.width / 2, spec.height / 2)
    target, up = np.array(rig.target), np.array([0.0, 0.0, 1.0])
    return tuple(
        pinhole(f"cam{i:02d}", (focal, focal), principal, size, look_at(eye, target, up))
        for i, eye in enumerate(places)
    )


def _eye(rig: CameraArc, turn: float, height: float) -> Float64:
    angle = turn * rig.half_arc
    x, y = rig.radius * math.sin(angle), rig.target[1] - rig.radius * math.cos(angle)
    return np.array([rig.target[0] + x, y, height])


def exposures(spec: SyntheticSpec, index: int = 0) -> Float64:
    """[C,3] factors on linear light of each camera's channels at a frame: its exposure times its white balance."""
    drifted = spec.exposure_drift * math.sin(2 * math.pi * index / (spec.fps * _DRIFT_SECONDS))
    stops = spec.exposure_spread * _stops(spec, 77) + drifted * _stops(spec, 78)
    stops[0] = 0.0
    return np.asarray(2.0**stops, np.float64)


def _stops(spec: SyntheticSpec, stream: int) -> Float64:
    """[C,3] normal values for each camera, and a quarter of that again for each of its channels."""
    generator = np.random.default_rng([spec.seed, stream])
    together = generator.standard_normal((spec.cameras, 1))
    return np.asarray(together + 0.25 * generator.standard_normal((spec.cameras, 3)), np.float64)
