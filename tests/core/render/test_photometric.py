"""The fused loss: value and gradient of the convolution form, whole and in part."""

import math
from itertools import combinations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from streamlod.core.render.tiles import Box
from streamlod.core.train.loss.photometric import WINDOW, photometric_loss, photometric_planes
from streamlod.core.train.loss.region import loss_boxes
from tests.core.render.scenes import make_camera
from tests.core.train.references import photometric_reference, ssim_reference
from tests.threads import MAX_THREADS, kernel_threads


def pictures(height: int, width: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    g = torch.Generator().manual_seed(seed)
    image = torch.rand(height, width, 3, generator=g)
    target = (image + 0.1 * torch.randn(height, width, 3, generator=g)).clamp(0, 1)
    return image, target


def pixel_weights(height: int, width: int) -> torch.Tensor:
    """From 0 to 3, another one for each channel."""
    return 3 * torch.rand(height, width, 3, generator=torch.Generator().manual_seed(5))


def value_and_gradient(
    image: torch.Tensor,
    target: torch.Tensor,
    region: tuple[Box, ...] | None,
    weight: float,
    pixel_weights: torch.Tensor | None = None,
) -> tuple[float, torch.Tensor]:
    leaf = image.clone().requires_grad_()
    loss = photometric_loss(leaf, target, weight, region, pixel_weights)
    loss.backward()
    assert leaf.grad is not None
    return float(loss.detach()), leaf.grad


CASES = [
    (40, 53, None, 0.2),
    (1, 1, None, 0.2),
    (3, 2, None, 0.5),
    (33, 257, None, 1.0),
    (90, 70, (Box(20, 30, 41, 62),), 0.2),
    (90, 70, (Box(0, 30, 41, 90),), 0.2),
    (90, 70, (Box(62, 0, 70, 5),), 0.2),
    (90, 70, (Box(7, 11, 8, 12),), 0.2),
    (90, 70, (Box(0, 0, 20, 16), Box(30, 0, 40, 30), Box(0, 60, 70, 90)), 0.2),
]


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("height", "width", "region", "weight"), CASES)
def test_fused_equals_convolutions(
    height: int, width: int, region: tuple[Box, ...] | None, weight: float, weighted: bool
) -> None:
    image, target = pictures(height, width)
    weights = pixel_weights(height, width) if weighted else None
    value, gradient = value_and_gradient(image, target, region, weight, weights)
    leaf = image.double().requires_grad_()
    wanted = photometric_reference(leaf, target.double(), weight, region, weights)
    wanted.backward()
    assert leaf.grad is not None
    assert value == pytest.approx(float(wanted.detach()), abs=1e-6)
    assert float((gradient - leaf.grad).norm() / leaf.grad.norm()) < 2e-6


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("height", "width", "region", "weight"), CASES)
def test_planes_equal_convolutions(
    height: int, width: int, region: tuple[Box, ...] | None, weight: float, weighted: bool
) -> None:
    image, target = (picture.double() for picture in pictures(height, width))
    weights = pixel_weights(height, width) if weighted else None
    outcomes = []
    for function in (photometric_loss, photometric_reference):
        leaf = image.clone().requires_grad_()
        loss = function(leaf, target, weight, region, weights)
        outcomes.append((loss.detach(), *torch.autograd.grad(3 * loss, leaf)))
    torch.testing.assert_close(outcomes[0], outcomes[1], rtol=1e-10, atol=1e-14)


def test_planes_agree_with_finite_differences() -> None:
    image, target = (picture.double() for picture in pictures(6, 7))
    assert torch.autograd.gradcheck(lambda x: photometric_loss(x, target), (image.requires_grad_(),), atol=1e-8)


def test_planes_hold_float32_to_the_numba_pass() -> None:
    image, target = pictures(64, 48)
    loss, mine = photometric_planes(image, target, 0.2, None, None)
    value, gradient = value_and_gradient(image, target, None, 0.2)
    assert float(loss) == pytest.approx(value, rel=1e-5)
    assert float((mine - gradient).norm() / gradient.norm()) < 1e-4


def test_convolution_form_agrees_with_finite_differences() -> None:
    image, target = (p.double() for p in pictures(6, 7))
    assert torch.autograd.gradcheck(lambda x: photometric_reference(x, target), (image.requires_grad_(),), atol=1e-8)


def test_part_has_the_gradient_of_the_whole() -> None:
    (image, target), boxes = pictures(90, 70), (Box(20, 30, 41, 62), Box(51, 30, 70, 40))
    _, part = value_and_gradient(image, target, boxes, 0.2)
    _, whole = value_and_gradient(image, target, None, 0.2)
    inside = torch.zeros(90, 70, dtype=torch.bool)
    for box in boxes:
        inside[box.top : box.bottom, box.left : box.right] = True
    assert torch.allclose(part[inside], whole[inside], rtol=0, atol=1e-9)
    assert not part[~inside].any()


def test_part_changes_as_the_whole_does() -> None:
    (image, target), boxes = pictures(90, 70), (Box(20, 30, 41, 62), Box(51, 30, 70, 40))
    changed = image.clone()
    for box in boxes:
        changed[box.top : box.bottom, box.left : box.right] *= 0.7
    difference = [
        float(photometric_loss(changed, target, region=b) - photometric_loss(image, target, region=b))
        for b in (None, boxes)
    ]
    assert difference[0] == pytest.approx(difference[1], abs=1e-6)
    assert abs(difference[0]) > 1e-3


def test_equal_pictures_cost_nothing() -> None:
    image, _ = pictures(20, 20)
    value, gradient = value_and_gradient(image, image.clone(), None, 0.2)
    assert abs(value) < 1e-6
    assert float(gradient.abs().max()) < 1e-6
    assert float((1 - ssim_reference(image, image)).abs().max()) < 1e-5


def test_gradient_is_the_same_for_any_number_of_threads() -> None:
    image, target = pictures(50, 60)
    found = []
    for count in (1, MAX_THREADS):
        with kernel_threads(count):
            found.append(value_and_gradient(image, target, None, 0.2)[1])
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


def test_pictures_of_different_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\[H,W,3\]"):
        photometric_loss(torch.zeros(3, 4), torch.zeros(3, 4))
    with pytest.raises(ValueError, match=r"\[H,W,3\]"):
        photometric_loss(torch.zeros(3, 4, 3), torch.zeros(4, 3, 3))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=9, max_size=9), min_size=7, max_size=7))
def test_boxes_hold_the_tiles_and_keep_apart(rows: list[list[bool]]) -> None:
    mask, camera = np.array(rows), make_camera(9 * 16 - 5, 7 * 16 - 3)
    boxes = loss_boxes(mask, camera)
    inside = np.zeros((camera.height, camera.width), np.bool_)
    for box in boxes:
        inside[box.top : box.bottom, box.left : box.right] = True
    assert inside[mask.repeat(16, axis=0).repeat(16, axis=1)[: camera.height, : camera.width]].all()
    assert (not boxes) == (not mask.any())
    for a, b in combinations(boxes, 2):  # no window looks at two of them
        assert max(a.left - b.right, b.left - a.right, a.top - b.bottom, b.top - a.bottom) >= WINDOW - 1


def test_things_far_apart_get_boxes_of_their_own() -> None:
    mask = np.zeros((30, 40), np.bool_)
    mask[1:4, 1:4] = mask[24:28, 33:38] = True
    assert loss_boxes(mask, make_camera(640, 480)) == (Box(16, 16, 64, 64), Box(528, 384, 608, 448))
    mask[1:4, 5] = True  # one column lies between: together they are less work
    assert loss_boxes(mask, make_camera(640, 480)) == (Box(16, 16, 96, 64), Box(528, 384, 608, 448))
