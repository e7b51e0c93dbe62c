"""Exposure of a picture by viewpoint: as a camera filmed where it stood, neutral away from all cameras.

Cameras of a real rig do not agree on brightness and white, and a scene has one neutral light for all of them
(`core.train.field.exposure`). A viewer who stands at a camera is shown what that camera filmed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.camera import Camera

MAX_GAIN, MAX_OFFSET = 64.0, 16.0


@dataclass(frozen=True, slots=True)
class CameraExposure:
    """A picture as a camera shows it: gain * neutral + offset, for each channel, RGB in [0, 1].

    Attributes:
        gain: [3], above 0 and at most `MAX_GAIN`. offset: [3], at most `MAX_OFFSET` in magnitude.

    Raises:
        ValueError: a value out of range.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not all(0 < gain <= MAX_GAIN for gain in self.gain):  # NaN fails too
            raise ValueError(f"gains {self.gain} must be above 0 and at most {MAX_GAIN:g}")
        if not all(abs(offset) <= MAX_OFFSET for offset in self.offset):
            raise ValueError(f"offsets {self.offset} must be at most {MAX_OFFSET:g} in magnitude")

    @property
    def is_neutral(self) -> bool:
        """Whether it changes nothing."""
        return self == NEUTRAL

    def apply(self, image: Float32) -> Float32:
        """`image` [H,W,3] as the camera shows it."""
        gain, offset = (np.array(values, np.float32) for values in (self.gain, self.offset))
        return np.asarray(image * gain + offset, np.float32)


NEUTRAL = CameraExposure()


def exposure_at(
    centre: Float64, cameras: Sequence[Camera], exposures: Sequence[CameraExposure] | None
) -> CameraExposure:
    """The exposure of a picture that is taken from `centre` [3].

    A camera's own at the camera; blended on the way to its nearest neighbour; neutral where every camera is farther
    away than its nearest neighbour is.

    Args:
        exposures: of the cameras in their order; None where they are not known.
    """
    if exposures is None or len(exposures) != len(cameras):
        return NEUTRAL
    weights = nearness(centre, np.stack([camera.centre for camera in cameras]))
    values = np.array([[*exposure.gain, *exposure.offset] for exposure in exposures])
    rest = max(1.0 - weights.sum(), 0.0)
    mixed = (weights @ values + rest * np.array([1.0, 1, 1, 0, 0, 0])) / (weights.sum() + rest)
    return CameraExposure(tuple(mixed[:3].tolist()), tuple(mixed[3:].tolist()))


def nearness(centre: Float64, cameras: Float64) -> Float64:
    """[C] from 1 at a camera, one of `cameras` [C,3], to 0 as far away as its nearest neighbour: a smooth step."""
    between = np.linalg.norm(cameras[:, None] - cameras, axis=2)
    np.fill_diagonal(between, np.inf)
    reach = between.min(axis=1)
    away = np.linalg.norm(cameras - centre, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.isfinite(reach), 1 - away / reach, 1.0)  # one camera alone: its own everywhere
    share = np.nan_to_num(share, nan=1.0, neginf=0.0).clip(0, 1)
    return np.asarray(share * share * (3 - 2 * share))
