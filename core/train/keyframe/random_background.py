"""Pictures of a first frame over a random colour, so that surfaces must become opaque to hide it.

Over black alone, a surface may stay half transparent wherever black makes its colour; to other views it shows what is
behind it. Where a picture is black itself, nothing at all may be there, as around a lit stage. And where first anchors
lie before hardly anything that a camera sees, nobody knows where what hides the colour should be: it comes to stand
anywhere, and hides the scene from other views.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from core.arrays import Float64
from core.camera import Camera
from core.initialise.views import inside, project
from core.render.compiling import Compiled
from core.train.pictures.views import Views

_BLACK = 1 / 16  # the brightest channel of a pixel that may show nothing at all
_NEAR = 5  # pixels: width of the square round an anchor's projection in which its surface is
_KNOWN = 0.25  # share of a picture in which surfaces must be known


def surfaces_are_known(positions: Tensor, views: Views) -> bool:
    """Whether anchors at `positions` [N,3] are seen in enough of every usable picture to say where its surfaces are."""
    points = positions.detach().double().cpu().numpy()
    return all(_coverage(points, views.cameras[number]) >= _KNOWN for number in views.usable)


def _coverage(points: Float64, camera: Camera) -> float:
    """The share of the picture of `camera` that lies near one of `points` [N,3]."""
    pixels, depth = project(camera, points)
    columns, rows = torch.from_numpy(pixels[inside(camera, pixels, depth)].astype(np.int64)).T
    seen = torch.zeros(1, camera.height, camera.width)
    seen[0, rows, columns] = 1
    return float(functional.max_pool2d(seen, _NEAR, 1, _NEAR // 2).mean())


def over_colour(image: Tensor, transmittance: Tensor, target: Tensor, colour: Tensor) -> Tensor:
    """`image` [H,W,3] over black, over `colour` [3] instead, but for pixels that `target` [H,W,3] shows black."""
    if image.device.type == "cpu":
        return over_colour_reference(image, transmittance, target, colour)
    shown: Tensor = _OnDevice.apply(image, transmittance, target, colour)  # type: ignore[no-untyped-call]
    return shown


def over_colour_reference(image: Tensor, transmittance: Tensor, target: Tensor, colour: Tensor) -> Tensor:
    """`over_colour` differentiated by torch, on any device."""
    return image + (transmittance * _lit(target))[..., None] * colour


def _lit(target: Tensor) -> Tensor:
    """[H,W] bool: pixels that are not black; by two maxima, which fuse with what follows."""
    red, green, blue = target.unbind(dim=2)
    return torch.maximum(torch.maximum(red, green), blue) > _BLACK


def _pulled(target: Tensor, colour: Tensor, upstream: Tensor) -> Tensor:
    """[H,W] derivative by the transmittance."""
    red, green, blue = (upstream * colour).unbind(dim=2)
    return (red + green + blue) * _lit(target)


_OVER, _PULLED = Compiled(over_colour_reference), Compiled(_pulled)


class _OnDevice(torch.autograd.Function):
    """`over_colour_reference` in few launches."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, transmittance: Tensor, target: Tensor, colour: Tensor) -> Tensor:
        ctx.save_for_backward(target, colour)
        shown: Tensor = _OVER(image, transmittance, target, colour)
        return shown

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        return upstream, _PULLED(*ctx.saved_tensors, upstream), None, None
