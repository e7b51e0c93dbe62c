"""Renders are compared with pictures as cameras film them: at their exposure, and clipped where they clip."""

from __future__ import annotations

import pytest
import torch

from streamlod.core.render.raster import Probe, Raster
from streamlod.core.train.config import KeyframeConfig
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.keyframe.drawing import ViewLoss
from streamlod.core.train.pictures.views import Views
from tests.core.train.keyframe.test_first_frame import ring

SIZE = (32, 48)


@pytest.mark.parametrize(("shown", "filmed", "pulled"), [(0.9, 1.0, 0), (0.7, 1.0, -1), (0.9, 0.95, 1), (0.05, 0.0, 0)])
def test_what_is_clipped_pulls_no_farther(shown: float, filmed: float, pulled: int) -> None:
    """At a gain of 1.3 and an offset of -0.1, 0.9 is shown as 1.07, 0.7 as 0.81, and 0.05 as -0.035."""
    exposure = Exposure(torch.full((1, 3), 1.3), torch.full((1, 3), -0.1))
    views = Views(ring(1), torch.full((1, *SIZE, 3), filmed), [0])
    image = torch.full((*SIZE, 3), shown, requires_grad=True)
    raster = Raster(image, torch.zeros(SIZE), Probe(torch.zeros(0, dtype=torch.int64)))
    loss = ViewLoss(views, exposure, KeyframeConfig(), "cpu").loss(raster, 0)
    loss.backward()  # type: ignore[no-untyped-call]
    assert image.grad is not None
    assert torch.equal(image.grad.sign(), torch.full_like(image, pulled))
    assert (abs(loss.item()) < 1e-5) == (pulled == 0)
