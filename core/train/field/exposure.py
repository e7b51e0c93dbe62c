"""Gain and offset a camera and channel: cameras of a real rig do not agree on brightness and white.

The picture of camera c is modelled as gain_c * render + offset_c. A common factor would be invisible, so the mean over
the cameras is held at gain 1 and offset 0. At every pixel the weights of the Gaussians and the light that they leave to
the background sum to one, so that gain and offset of the colours and of the background make the same picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from streamlod.core.scene.exposures import MAX_GAIN, MAX_OFFSET, CameraExposure
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.pictures.clipping import CLIPPED

_FLAT = 1e-4  # variance of grey values in units of [0, 1], below which a picture says nothing about gain
_GAINS = (0.25, 4.0)


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """gain [C,3] and offset [C,3] of C cameras."""

    gain: Tensor
    offset: Tensor

    def apply(self, image: Tensor, camera: int) -> Tensor:
        """`image` [H,W,3] as camera number `camera` would show it."""
        if image.device.type != "cpu":
            shown: Tensor = _Applied.apply(image, self.gain, self.offset, camera)  # type: ignore[no-untyped-call]
            return shown
        gain, offset = (values[camera].repeat(image.shape[1]) for values in (self.gain, self.offset))
        # row by row: on the CPU, passes over an innermost axis of three take five times as long
        return torch.addcmul(offset, image.flatten(1), gain).view(image.shape)

    def before(self, splats: Splats, camera: int) -> Splats:
        """`splats` whose picture over `offset` is the one that `apply` makes of that of `splats` over black."""
        return replace(splats, colours=torch.addcmul(self.offset[camera], splats.colours, self.gain[camera]))

    def centre(self) -> None:
        """Bring the mean over the cameras back to gain 1 and offset 0."""
        with torch.no_grad():
            self.gain.sub_(self.gain.mean(dim=0) - 1)
            self.offset.sub_(self.offset.mean(dim=0))

    def of_cameras(self) -> tuple[CameraExposure, ...]:
        """The values of each camera, as players are told them."""
        gains = self.gain.detach().clamp(1 / MAX_GAIN, MAX_GAIN).tolist()
        offsets = self.offset.detach().clamp(-MAX_OFFSET, MAX_OFFSET).tolist()
        return tuple(CameraExposure(tuple(gain), tuple(offset)) for gain, offset in zip(gains, offsets, strict=True))

    def then(self, later: Exposure) -> Exposure:
        """This one and after it `later`."""
        return Exposure(later.gain * self.gain, torch.addcmul(later.offset, later.gain, self.offset))

    def frozen(self) -> Exposure:
        """The same values, no longer trained."""
        return Exposure(self.gain.detach().clone(), self.offset.detach().clone())


class _Applied(torch.autograd.Function):
    """`Exposure.apply` in few launches."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, gain: Tensor, offset: Tensor, camera: int) -> Tensor:
        ctx.save_for_backward(image, gain)
        ctx.camera = camera
        return torch.addcmul(offset[camera], image, gain[camera])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        image, gain = ctx.saved_tensors
        by_gain, by_offset = gain.new_zeros(2, *gain.shape)
        torch.sum(upstream * image, dim=(0, 1), out=by_gain[ctx.camera])
        torch.sum(upstream, dim=(0, 1), out=by_offset[ctx.camera])
        return upstream * gain[ctx.camera], by_gain, by_offset, None


def neutral(cameras: int, device: str | torch.device = "cpu") -> Exposure:
    """No correction for any of `cameras`."""
    return Exposure(torch.ones(cameras, 3, device=device), torch.zeros(cameras, 3, device=device))


def exposure_of(cameras: Sequence[CameraExposure], device: str | torch.device) -> Exposure:
    """The exposures of `cameras` as players are told them."""
    gain, offset = (torch.tensor([getattr(c, name) for c in cameras], device=device) for name in ("gain", "offset"))
    return Exposure(gain, offset)


def fitted(shown: Tensor, targets: Tensor, cameras: list[int]) -> Exposure:
    """The exposures under which `shown` [C,H,W,3] comes nearest to `targets` [C,H,W,3], a camera and channel at a time.

    Least squares over the pixels that are not clipped in the target, for a scene whose exposures are not known any
    more; neutral for other `cameras`, and where a picture is all of one colour.
    """
    exposure = neutral(len(shown), shown.device)
    for number in cameras:
        picture, target = (pictures[number].flatten(0, 1).double() for pictures in (shown, targets))
        whole = ((target > CLIPPED) & (target < 1 - CLIPPED)).double()
        weight = whole / whole.sum(dim=0).clamp_min(1)
        middle, wanted = (weight * picture).sum(dim=0), (weight * target).sum(dim=0)
        spread = picture - middle
        variance = (weight * spread.square()).sum(dim=0)
        gain = (weight * spread * (target - wanted)).sum(dim=0) / variance.clamp_min(1e-12)
        gain = torch.where(variance > _FLAT, gain.clamp(*_GAINS), 1.0)
        exposure.gain[number] = gain.float()
        exposure.offset[number] = (wanted - gain * middle).float()
    return exposure
