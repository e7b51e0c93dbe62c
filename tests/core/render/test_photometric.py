"""The fused loss: value and gradient of the convolution form, whole and in part."""

import math

import numba
import pytest
import torch

from core.render.tiles import Box
from core.train.losses import photometric_loss, photometric_reference, ssim_map


def pictures(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    image = torch.rand(height, width, 3, generator=g)
    target = (image + 0.1 * torch.randn(height, width, 3, generator=g)).clamp(0, 1)
    return image, target


def value_and_gradient(
    image: torch.Tensor, target: torch.Tensor, box: Box | None, weight: float
) -> tuple[float, torch.Tensor]:
    leaf = image.clone().requires_grad_()
    loss = photometric_loss(leaf, target, weight, box)
    loss.backward()
    assert leaf.grad is not None
    return float(loss.detach()), leaf.grad


CASES = [
    (40, 53, None, 0.2),
    (1, 1, None, 0.2),
    (3, 2, None, 0.5),
    (33, 257, None, 1.0),
    (90, 70, Box(20, 30, 41, 62), 0.2),
    (90, 70, Box(0, 30, 41, 90), 0.2),
    (90, 70, Box(62, 0, 70, 5), 0.2),
    (90, 70, Box(7, 11, 8, 12), 0.2),
]


@pytest.mark.parametrize(("height", "width", "box", "weight"), CASES)
def test_fused_equals_convolutions(height: int, width: int, box: Box | None, weight: float) -> None:
    image, target = pictures(height, width)
    value, gradient = value_and_gradient(image, target, box, weight)
    leaf = image.double().requires_grad_()
    wanted = photometric_reference(leaf, target.double(), weight, box)
    wanted.backward()
    assert leaf.grad is not None
    assert value == pytest.approx(float(wanted.detach()), abs=1e-6)
    assert float((gradient - leaf.grad).norm() / leaf.grad.norm()) < 2e-6


def test_convolution_form_agrees_with_finite_differences() -> None:
    image, target = (p.double() for p in pictures(6, 7))
    assert torch.autograd.gradcheck(lambda x: photometric_reference(x, target), (image.requires_grad_(),), atol=1e-8)


def test_part_has_the_gradient_of_the_whole() -> None:
    (image, target), box = pictures(90, 70), Box(20, 30, 41, 62)
    _, part = value_and_gradient(image, target, box, 0.2)
    _, whole = value_and_gradient(image, target, None, 0.2)
    inside = torch.zeros(90, 70, dtype=torch.bool)
    inside[box.top : box.bottom, box.left : box.right] = True
    assert torch.allclose(part[inside], whole[inside], rtol=0, atol=1e-9)
    assert not part[~inside].any()


def test_part_changes_as_the_whole_does() -> None:
    (image, target), box = pictures(90, 70), Box(20, 30, 41, 62)
    changed = image.clone()
    changed[box.top : box.bottom, box.left : box.right] *= 0.7
    difference = [
        float(photometric_loss(changed, target, region=b) - photometric_loss(image, target, region=b))
        for b in (None, box)
    ]
    assert difference[0] == pytest.approx(difference[1], abs=1e-6)
    assert abs(difference[0]) > 1e-3


def test_equal_pictures_cost_nothing() -> None:
    image, _ = pictures(20, 20)
    value, gradient = value_and_gradient(image, image.clone(), None, 0.2)
    assert abs(value) < 1e-6
    assert float(gradient.abs().max()) < 1e-6
    assert float((1 - ssim_map(image, image)).abs().max()) < 1e-5


def test_gradient_is_the_same_for_any_number_of_threads() -> None:
    image, target = pictures(50, 60)
    threads = numba.get_num_threads()
    found = []
    for count in {1, threads}:
        numba.set_num_threads(count)
        found.append(value_and_gradient(image, target, None, 0.2)[1])
    numba.set_num_threads(threads)
    assert all(torch.equal(found[0], other) for other in found)


def test_upstream_factor_scales_the_gradient() -> None:
    image, target = pictures(12, 12)
    leaf = image.clone().requires_grad_()
    (3 * photometric_loss(leaf, target)).backward()
    assert leaf.grad is not None
    assert torch.allclose(leaf.grad, 3 * value_and_gradient(image, target, None, 0.2)[1])


def test_a_broken_picture_is_not_silent() -> None:
    image, target = pictures(30, 30)
    image[10, 10] = float("nan")
    value, gradient = value_and_gradient(image, target, None, 0.2)
    assert math.isnan(value)
    assert gradient.isnan().any()


@pytest.mark.parametrize("box", [Box(0, 0, 0, 5), Box(-1, 0, 5, 5), Box(0, 0, 31, 5)])
def test_impossible_regions_are_refused(box: Box) -> None:
    with pytest.raises(ValueError, match="does not lie inside"):
        photometric_loss(*pictures(30, 30), region=box)
    with pytest.raises(ValueError, match=r"\[H,W,3\]"):
        photometric_loss(torch.zeros(3, 4), torch.zeros(3, 4))
