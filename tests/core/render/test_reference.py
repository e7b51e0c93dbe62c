"""The oracle itself: against finite differences and against pictures worked out by hand."""

import math

import numpy as np
import torch

from streamlod.core.camera import pinhole
from streamlod.core.render import rasterise
from tests.core.render.scenes import NAMES, make_camera, make_cloud


def test_gradients_agree_with_finite_differences() -> None:
    cloud, camera = make_cloud(5, seed=4, size=0.5, spread=0.6), make_camera(7, 6)
    parameters = [torch.tensor(getattr(cloud, name), dtype=torch.float64, requires_grad=True) for name in NAMES]
    background = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)

    def picture(*values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        raster = rasterise(*values, camera, background, backend="reference")
        return raster.image, raster.transmittance

    assert torch.autograd.gradcheck(picture, parameters, eps=1e-6, atol=1e-7, rtol=1e-5, fast_mode=True)


def test_one_gaussian_on_the_axis_has_the_closed_form() -> None:
    camera = pinhole("axis", (20.0, 20.0), (4.5, 4.5), (9, 9), np.eye(4))
    one = [
        torch.tensor(v, dtype=torch.float64)
        for v in ([[0, 0, 2.0]], [[3.0, 0, 0, 0]], [[0.1] * 3], [0.8], [[1.0, 0, 0]])
    ]
    raster = rasterise(*one, camera, torch.zeros(3, dtype=torch.float64), backend="reference")
    variance = (20 * 0.1 / 2) ** 2 + 0.1
    for x, y in ((4, 4), (6, 4), (3, 2)):
        sigma = ((x - 4) ** 2 + (y - 4) ** 2) / (2 * variance)
        wanted = 0.8 * math.exp(-sigma)
        assert abs(float(raster.image[y, x, 0]) - wanted) < 1e-12
        assert abs(float(raster.transmittance[y, x]) - (1 - wanted)) < 1e-12
    assert float(raster.image[..., 1:].abs().max()) == 0
