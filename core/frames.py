"""Synchronised pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Bool, Float32, UInt8, check_array


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """The pictures of all cameras at one instant.

    Attributes:
        index: number of the instant in its source, from 0.
        time_ns: capture time in nanoseconds (Unix time when known, otherwise from the clip's start).
        images: [C,H,W,3] uint8 RGB, in the order of the cameras; zeros where a camera is missing.
        present: [C] bool, False where a camera delivered nothing for this instant.
        latency_ns: from filming to delivery, nanoseconds, where a live source knows it.
    """

    index: int
    time_ns: int
    images: UInt8
    present: Bool
    latency_ns: int | None = None

    def __post_init__(self) -> None:
        check_array("images", self.images, (None, None, None, 3), np.uint8)
        check_array("present", self.present, (len(self.images),), np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud:
    """First points of a scene: positions [N,3] float32 in world units, colours [N,3] float32 in [0, 1]."""

    positions: Float32
    colours: Float32

    def __post_init__(self) -> None:
        check_array("positions", self.positions, (None, 3), np.float32)
        check_array("colours", self.colours, (len(self.positions), 3), np.float32)

    def __len__(self) -> int:
        return len(self.positions)
