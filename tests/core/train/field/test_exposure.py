"""Exposures: gain and offset of the picture, and of what makes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from streamlod.core.camera import pinhole
from streamlod.core.render.backends import Backend
from streamlod.core.render.differentiable import rasterise
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.exposure import Exposure, fitted, neutral

CAMERA = pinhole("camera", (40, 40), (24, 16), (48, 32), np.eye(4))
EXPOSURE = Exposure(torch.tensor([[1.0, 1.0, 1.0], [0.8, 1.1, 1.3]]), torch.tensor([[0.0, 0, 0], [0.05, -0.02, 0.1]]))
BACKGROUND = torch.tensor([0.2, 0.0, 0.7])


def splats() -> Splats:
    """Some pixels are opaque, some see the background."""
    random = torch.Generator().manual_seed(0)
    means = torch.rand(120, 3, generator=random) * torch.tensor([1.0, 0.8, 2.0]) + torch.tensor([-0.6, -0.4, 1.0])
    return Splats(
        means,
        torch.randn(120, 4, generator=random),
        torch.rand(120, 3, generator=random) * 0.15,
        torch.rand(120, generator=random) * 1.2 - 0.1,
        torch.rand(120, 3, generator=random),
    )


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_exposed_colours_make_the_exposed_picture(backend: Backend) -> None:
    cloud, weight = splats(), torch.rand(32, 48, 3, generator=torch.Generator().manual_seed(1))

    def draw(before: bool) -> tuple[Tensor, list[Tensor]]:
        leaves = [part.clone().requires_grad_() for part in cloud.astuple()]
        drawn = Splats(*leaves)
        background = EXPOSURE.gain[1] * BACKGROUND + EXPOSURE.offset[1] if before else BACKGROUND
        drawn = EXPOSURE.before(drawn, 1) if before else drawn
        image = rasterise(*drawn.astuple(), camera=CAMERA, background=background, backend=backend).image
        image = image if before else EXPOSURE.apply(image, 1)
        (image * weight).sum().backward()  # type: ignore[no-untyped-call]
        return image.detach(), [leaf.grad for leaf in leaves if leaf.grad is not None]

    (image, gradients), (expected, wanted) = draw(True), draw(False)
    torch.testing.assert_close(image, expected, atol=3e-6, rtol=0)
    assert len(gradients) == 5
    for gradient, other in zip(gradients, wanted, strict=True):
        assert float((gradient - other).norm() / other.norm()) < 1e-4


def test_a_neutral_exposure_changes_no_bit() -> None:
    cloud = splats()
    assert torch.equal(neutral(2).before(cloud, 1).colours, cloud.colours)


def test_the_mean_over_the_cameras_is_held() -> None:
    exposure = Exposure(EXPOSURE.gain.clone(), EXPOSURE.offset.clone())
    exposure.centre()
    torch.testing.assert_close(exposure.gain.mean(dim=0), torch.ones(3))
    torch.testing.assert_close(exposure.offset.mean(dim=0), torch.zeros(3))
    torch.testing.assert_close(exposure.gain[1] - exposure.gain[0], EXPOSURE.gain[1] - EXPOSURE.gain[0])


def test_exposures_are_found_again_from_pictures() -> None:
    shown = torch.rand(2, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    truth = replace(neutral(2), gain=EXPOSURE.gain[[1, 0]], offset=EXPOSURE.offset[[1, 0]])
    targets = torch.stack([truth.apply(shown[0], 0), shown[1]])
    found = fitted(shown, targets, [0])
    torch.testing.assert_close(found.gain, truth.gain, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.offset, truth.offset, atol=1e-4, rtol=1e-4)
    flat = fitted(torch.full((1, 4, 4, 3), 0.5), torch.full((1, 4, 4, 3), 0.7), [0])
    assert (flat.gain == 1).all()
    torch.testing.assert_close(flat.offset, torch.full((1, 3), 0.2))


def test_what_a_camera_clipped_says_nothing_of_its_exposure() -> None:
    shown = torch.rand(1, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    bright = Exposure(torch.full((1, 3), 1.8), torch.full((1, 3), -0.2))
    found = fitted(shown, bright.apply(shown[0], 0).clamp(0, 1)[None], [0])
    torch.testing.assert_close(found.gain, bright.gain, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(found.offset, bright.offset, atol=1e-4, rtol=1e-4)
    white = fitted(shown, torch.ones(1, 20, 30, 3), [0])
    assert (white.gain == 1).all()
    assert (white.offset == 0).all()
