"""Rendering the training cameras of a first frame, and the loss against their pictures."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from core.render.backends import Backend
from core.render.differentiable import rasterise
from core.render.raster import Raster
from core.train.config import KeyframeConfig
from core.train.field.decode import Splats
from core.train.field.exposure import Exposure
from core.train.optimise.losses import photometric_loss
from core.train.pictures.views import Views


@dataclass(frozen=True, slots=True, eq=False)
class ViewLoss:
    """Renders training cameras and compares them with their pictures at their exposures."""

    views: Views
    exposure: Exposure
    config: KeyframeConfig
    backend: Backend

    def draw(self, splats: Splats, number: int) -> Raster:
        """What camera `number` would see at a neutral exposure."""
        camera = self.views.cameras[number]
        return rasterise(*splats.astuple(), camera, torch.zeros(3, device=splats.means.device), backend=self.backend)

    def loss(self, raster: Raster, splats: Splats, number: int) -> Tensor:
        """Equation 10 of the paper, with Scaffold-GS's regulariser of the volume (docs/method.md, reading 20)."""
        image = self.exposure.apply(raster.image, number)
        loss = photometric_loss(image, self.views.targets[number], self.config.dssim_weight)
        if self.config.scale_weight:
            drawn = splats.opacities.detach() > 0
            loss = loss + self.config.scale_weight * splats.scales.prod(dim=1)[drawn].sum() / drawn.sum().clamp_min(1)
        return loss

    @torch.no_grad()
    def squared_error(self, raster: Raster, number: int) -> float:
        """Summed over all values of camera `number`'s picture."""
        shown = self.exposure.apply(raster.image, number)
        return float((shown - self.views.targets[number]).square().sum())
