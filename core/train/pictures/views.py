"""The pictures of one instant, as training uses them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.camera import Camera
from streamlod.core.train.pictures.clipping import clipped_sides

_MIN_ROWS = 80  # of small pictures


@dataclass(frozen=True, eq=False)  # without slots, to keep what is worked out once
class Views:
    """Training pictures: cameras, targets [C,H,W,3] float32 in [0, 1], and which of them are there."""

    cameras: tuple[Camera, ...]
    targets: Tensor
    usable: list[int]

    @cached_property
    def centres(self) -> list[Tensor]:
        """C times [3] where a camera stands, on the device of the pictures."""
        return [torch.from_numpy(camera.centre).float().to(self.targets.device) for camera in self.cameras]

    @cached_property
    def clipped(self) -> Tensor:
        """[C,H,W,3] int8 to which side a picture is clipped, if at all, as `clipping.clipped_sides` says it."""
        return clipped_sides(self.targets)

    @property
    def contrast(self) -> float:
        """Mean absolute deviation of values from the mean of their picture and channel, over the usable pictures."""
        pictures = self.targets[self.usable]
        return float((pictures - pictures.mean(dim=(1, 2), keepdim=True)).abs().mean())

    def or_before(self, pictures: Tensor) -> Tensor:
        """[C,H,W,3] these pictures, and those of `pictures` [C,H,W,3] of cameras that are not there."""
        if len(self.usable) == len(self.cameras):
            return self.targets  # a copy of four pictures of 1280x720 takes 80 ms
        latest = pictures.clone()
        latest[self.usable] = self.targets[self.usable]
        return latest

    def halved(self) -> Views:
        """The same pictures at half the width and height: each pixel is the mean of those it covers."""
        targets = halved_pictures(self.targets)
        height, width = targets.shape[1:3]
        return Views(tuple(camera.scaled(width, height) for camera in self.cameras), targets, self.usable)

    def sizes(self) -> list[Views]:
        """The pictures at half the width and height again and again, the smallest first, the whole ones last.

        None is smaller than 80 rows, so that small ones are there at their own size alone.
        """
        sizes = [self]
        while sizes[0].targets.shape[1] >= 2 * _MIN_ROWS:
            sizes.insert(0, sizes[0].halved())
        return sizes


def halved_pictures(pictures: Tensor) -> Tensor:
    """[C,H,W,3] pictures at half the width and height: each pixel is the mean of those it covers."""
    height, width = (max(size // 2, 1) for size in pictures.shape[1:3])
    if pictures.shape[1:3] == (2 * height, 2 * width):  # much faster than the general way
        pairs = pictures[:, ::2] + pictures[:, 1::2]
        return (pairs[:, :, ::2] + pairs[:, :, 1::2]) / 4
    return (
        functional.adaptive_avg_pool2d(pictures.permute(0, 3, 1, 2), (height, width)).permute(0, 2, 3, 1).contiguous()
    )
