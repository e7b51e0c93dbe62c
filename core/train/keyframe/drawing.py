"""Rendering the training cameras of a first frame, and the loss against their pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.render.backends import Backend
from streamlod.core.render.differentiable import rasterise
from streamlod.core.render.raster import Raster
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.keyframe.random_background import over_colour
from streamlod.core.train.loss.penalty import penalty
from streamlod.core.train.loss.photometric import photometric_loss
from streamlod.core.train.pictures.clipping import limited
from streamlod.core.train.pictures.views import Views


@dataclass(frozen=True, slots=True, eq=False)
class ViewLoss:
    """Renders training cameras and compares them with their pictures at their exposures."""

    views: Views
    exposure: Exposure
    config: KeyframeConfig
    backend: Backend

    def draw(self, splats: Splats, number: int) -> Raster:
        """What camera `number` would see at a neutral exposure, over black."""
        camera = self.views.cameras[number]
        return rasterise(*splats.astuple(), camera, torch.zeros(3, device=splats.means.device), backend=self.backend)

    def over(self, raster: Raster, number: int, colour: Tensor) -> Raster:
        """`raster` of camera `number` over `colour` [3], except where the picture is black."""
        image = over_colour(raster.image, raster.transmittance, self.views.targets[number], colour)
        return replace(raster, image=image)

    def loss(self, raster: Raster, number: int) -> Tensor:
        """[] how far camera `number` is from its picture."""
        image, target = self.exposure.apply(raster.image, number), self.views.targets[number]
        shown = limited(image, target, self.views.clipped[number])
        return photometric_loss(shown, target, self.config.dssim_weight)

    def penalty(self, splats: Splats, raster: Raster, share: Tensor, hiding: Tensor) -> Tensor:
        """What Gaussians cost whatever they show: volume and, of those in view of `raster`, opacity.

        With few views many Gaussians are not constrained by any picture. A penalty on opacity removes those, as in
        Kheradmand et al. 2024. Its weight is divided by the number of other cameras (at least 1): the more of them see
        what one camera sees, the less it is needed. Only what is in view pays: else a Gaussian that one camera alone
        looks at would pay in every camera's steps for what it gains in one of them.

        Args:
            share, hiding: as `core.train.loss.penalty.penalty` has them.
        """
        config = self.config
        opacity_weight = config.opacity_weight / max(len(self.views.usable) - 1, 1)
        weights = config.scale_weight, opacity_weight
        return penalty(splats.scales, splats.opacities, raster.probe.visible, *weights, share, hiding)

    @torch.no_grad()
    def squared_error(self, raster: Raster, number: int) -> float:
        """Summed over all values of camera `number`'s picture."""
        shown = self.exposure.apply(raster.image, number)
        return float((shown - self.views.targets[number]).square().sum())
