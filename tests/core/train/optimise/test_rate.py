"""The rate term against the bytes that the codec makes of the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from streamlod.codec.chunks.change import Elapsed
from streamlod.codec.chunks.level import encode_change
from streamlod.core.scene.anchors import LATENTS
from streamlod.core.train.field.rounding import dead_zone
from streamlod.core.train.optimise.rate import residual_bits
from tests.codec.scenes import make_scene


@pytest.mark.parametrize("share", [0.15, 0.4])
@pytest.mark.parametrize("size", [0.4, 1.5])
def test_it_is_about_what_is_sent(share: float, size: float) -> None:
    rng = np.random.default_rng(0)
    level = make_scene((3000,)).levels[0]
    rows = np.flatnonzero(rng.random(len(level)) < share)
    energy = rng.gamma(1, 1, (len(rows), 1)) * size
    latent = dead_zone(torch.from_numpy(rng.laplace(0, 1, (len(rows), LATENTS)) * energy)).numpy().astype(np.int64)
    position = dead_zone(torch.from_numpy(rng.laplace(0, 1, (len(rows), 3)) * energy)).numpy().astype(np.int64)
    changed = latent.any(axis=1) | position.any(axis=1)
    rows, latent, position = rows[changed], latent[changed], position[changed]
    sent = 8 * len(encode_change(level, rows, position, latent, Elapsed(0, 1), 1))
    found = residual_bits(torch.from_numpy(latent).float(), torch.from_numpy(position).float())
    assert float(found) == pytest.approx(sent, rel=0.12)


def test_smaller_residuals_are_cheaper_and_the_gradient_says_so() -> None:
    generator = torch.Generator().manual_seed(0)
    latent = torch.randn(200, LATENTS, generator=generator, dtype=torch.float64).requires_grad_()
    position = torch.randn(200, 3, generator=generator, dtype=torch.float64).requires_grad_()
    bits = residual_bits(latent, position)
    bits.backward()  # type: ignore[no-untyped-call]
    assert latent.grad is not None
    assert position.grad is not None
    assert bool(((latent.grad * latent.detach()) >= 0).all())
    step = 1e-5
    moved = residual_bits(latent.detach() - step * latent.grad, position.detach() - step * position.grad)
    expected = step * float((latent.grad**2).sum() + (position.grad**2).sum())
    assert float(bits.detach() - moved) == pytest.approx(expected, rel=0.05)


def test_what_does_not_change_costs_little() -> None:
    nothing = float(residual_bits(torch.zeros(500, LATENTS), torch.zeros(500, 3)))
    one = torch.zeros(500, LATENTS)
    one[7, 3] = 1.0
    assert nothing < 0.03 * 500 * (LATENTS + 3)
    assert 10 < float(residual_bits(one, torch.zeros(500, 3))) - nothing < 20
