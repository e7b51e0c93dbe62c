"""Pictures of a state at its cameras."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.render.differentiable import rasterise
from streamlod.core.train.field.field import Field
from streamlod.core.train.pictures.views import Views


def rendered(field: Field, alive: Tensor, views: Views, backend: Backend) -> Tensor:
    """[C,H,W,3] what `field` shows the usable cameras now; NaN for the others."""
    pictures = torch.full_like(views.targets, torch.nan)
    rows = torch.nonzero(alive)[:, 0]
    background = torch.zeros(3, device=rows.device)
    with torch.no_grad():
        for number in views.usable:
            camera = views.cameras[number]
            splats = field.decode(views.centres[number], rows)
            raster = rasterise(*splats.astuple(), camera=camera, background=background, backend=backend)
            pictures[number] = raster.image.clamp(0, 1)
    return pictures
