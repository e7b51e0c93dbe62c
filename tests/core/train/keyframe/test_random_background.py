"""Pictures over a colour."""

from __future__ import annotations

import torch

from streamlod.core.train.keyframe.random_background import over_colour


def test_the_colour_is_seen_where_the_picture_is_not_black() -> None:
    target = torch.zeros(1, 2, 3)
    target[0, 1, 2] = 0.5
    shown = over_colour(torch.full((1, 2, 3), 0.1), torch.full((1, 2), 0.5), target, torch.tensor([0.2, 0.4, 0.6]))
    torch.testing.assert_close(shown, torch.tensor([[[0.1, 0.1, 0.1], [0.2, 0.3, 0.4]]]))


def test_the_gradient_that_is_written_down_agrees_with_finite_differences() -> None:
    generator = torch.Generator().manual_seed(0)
    image, target = torch.rand(2, 4, 5, 3, generator=generator, dtype=torch.float64)
    leaves = image.requires_grad_(), torch.rand(4, 5, generator=generator, dtype=torch.float64).requires_grad_()
    colour = torch.rand(3, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda one, other: over_colour(one, other, target / 8, colour), leaves)
