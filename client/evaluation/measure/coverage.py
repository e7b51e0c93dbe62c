"""How much of a picture each anchor shows: blending weights, summed over pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.render.differentiable import rasterise
from streamlod.core.train.field.field import Field

_CHANNELS = 3


def coverage(field: Field, rows: Tensor, camera: Camera, maps: Tensor) -> Tensor:
    """[n,M] sum over the pixels of each of M <= 3 maps times the blending weights of the anchors `rows`, in pixels.

    A picture is linear in its Gaussians' colours, with the blending weights as factors; so the gradient by the colours
    of a sum over weighted pixels is what is asked for, and one backward pass answers for three maps.

    Args:
        maps: [H,W,M] float32 weights of the pixels; of ones, for the area that an anchor shows.
    """
    with torch.no_grad():
        splats = field.decode(torch.from_numpy(camera.centre).float(), rows)
    colours = splats.colours.requires_grad_()
    raster = rasterise(
        *splats.astuple()[:4],
        colours,
        camera=camera,
        background=torch.zeros(3),
        gradient_rows=len(rows) * field.slots,
        backend="cpu",
    )
    count = maps.shape[2]
    upstream = torch.zeros(*maps.shape[:2], _CHANNELS)
    upstream[..., :count] = maps
    raster.image.backward(upstream)  # type: ignore[no-untyped-call]
    assert colours.grad is not None
    return colours.grad.reshape(-1, field.slots, _CHANNELS).sum(dim=1)[:, :count]
