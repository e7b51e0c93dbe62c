"""How far a rendered picture is from the filmed one.

Loss of Kerbl et al. 2023, equation 7: (1 - w) L1 + w (1 - SSIM), SSIM with an 11x11 Gaussian window of sigma 1.5 and
zero padding, means over all pixels and channels; absolute differences may be weighted. Three forms of one loss: a numba
pass on the CPU, `photometric_planes` on other devices, and a reference in the tests, which says it plainly.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.render.tiles import Box
from streamlod.core.train.loss.known_gradient import with_gradient

WINDOW, SIGMA = 11, 1.5
_C1, _C2 = 0.01**2, 0.03**2


def photometric_loss(
    image: Tensor,
    target: Tensor,
    dssim_weight: float = 0.2,
    region: Sequence[Box] | None = None,
    pixel_weights: Tensor | None = None,
) -> Tensor:
    """Scalar loss of `image` [H,W,3] float32 against `target` [H,W,3], both in [0, 1]; differentiable by `image`.

    Args:
        dssim_weight: w above.
        region: evaluate only what the pixels of these boxes change. The gradient inside is that of the whole loss and
            zero outside; the value differs from the whole loss by what does not depend on the boxes' pixels. Boxes
            must lie in the picture, ten pixels apart.
        pixel_weights: [H,W,3] weights of the absolute differences; None for ones.

    Raises:
        ValueError: the shapes differ or are not [H,W,3].
    """
    if image.shape != target.shape or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"pictures must both be [H,W,3], not {tuple(image.shape)} and {tuple(target.shape)}")
    by_numba = image.device.type == "cpu" and image.dtype == torch.float32
    found = _by_numba if by_numba else photometric_planes
    value, gradient = found(image, target, dssim_weight, region, pixel_weights)
    return with_gradient(value, [image], [gradient])


def _by_numba(
    image: Tensor, target: Tensor, dssim_weight: float, region: Sequence[Box] | None, pixel_weights: Tensor | None
) -> tuple[Tensor, Tensor]:
    from streamlod.core.render.cpu.photometric import photometric_sums

    boxes = (Box(0, 0, image.shape[1], image.shape[0]),) if region is None else tuple(region)
    drawn, filmed = image.detach().contiguous().numpy(), target.detach().contiguous().numpy()
    counted = None if pixel_weights is None else pixel_weights.contiguous().numpy()
    value, gradient = photometric_sums(drawn, filmed, dssim_weight, boxes, counted)
    return image.new_tensor(value), torch.from_numpy(gradient)


@torch.no_grad()
def photometric_planes(
    image: Tensor, target: Tensor, weight: float, region: Sequence[Box] | None, pixel_weights: Tensor | None
) -> tuple[Tensor, Tensor]:
    """`photometric_loss` and its gradient [H,W,3] on any device and for any float type.

    What is blurred is stacked into one batch of planes, twice convolved with a line; all else is done pixel by pixel.
    Nothing in it waits for the device.
    """
    inside, near = (None if region is None else _pixels(image, region, room) for room in (0, WINDOW // 2))
    counted = inside
    if pixel_weights is not None:
        counted = pixel_weights if inside is None else inside * pixel_weights
    a, b = image.permute(2, 0, 1), target.permute(2, 0, 1)
    blurred = _blurred(torch.stack([a, b, a * a, b * b, a * b]))
    losses, slopes = _similarity(blurred, image, target, weight, near, counted)
    return losses.mean(), _slope(image, target, _blurred(slopes), inside, counted, weight)


def _pixels(image: Tensor, boxes: Sequence[Box], room: int) -> Tensor:
    """[H,W,1] bool: pixels of the boxes and `room` around them."""
    found = torch.zeros(*image.shape[:2], 1, dtype=torch.bool, device=image.device)
    for box in boxes:
        found[max(0, box.top - room) : box.bottom + room, max(0, box.left - room) : box.right + room] = True
    return found


@functools.lru_cache(maxsize=8)
def _line(dtype: torch.dtype, device: torch.device) -> Tensor:
    """[WINDOW] the window along one axis, which sums to 1."""
    offsets = torch.arange(WINDOW, dtype=dtype, device=device) - WINDOW // 2
    line = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    return line.div(line.sum())


def _blurred(planes: Tensor) -> Tensor:
    """[N,3,H,W] planes after the window along both axes."""
    line, (count, channels, height, width) = _line(planes.dtype, planes.device), planes.shape
    flat = planes.reshape(count * channels, 1, height, width)
    flat = functional.conv2d(flat, line[None, None, None, :], padding=(0, WINDOW // 2))
    blurred: Tensor = functional.conv2d(flat, line[None, None, :, None], padding=(WINDOW // 2, 0))
    return blurred.view(planes.shape)


def blurred_moments(pictures: Tensor) -> tuple[Tensor, Tensor]:
    """Pictures [C,H,W,3] and their squares, both after SSIM's window."""
    planes = torch.cat([pictures, pictures * pictures]).permute(0, 3, 1, 2)
    mean, square = _blurred(planes).permute(0, 2, 3, 1).chunk(2)
    return mean, square


def _similarity(
    blurred: Tensor, image: Tensor, target: Tensor, weight: float, near: Tensor | None, counted: Tensor | None
) -> tuple[Tensor, Tensor]:
    """The loss of each pixel [3,H,W], of the pictures and of what SSIM blurs, after that [5,3,H,W]; and SSIM's
    derivatives [3,3,H,W] by the blurred image, its blurred square and the blurred product.

    SSIM is l s / (m v), its factors as named in brackets below (Wang et al. 2004, equation 13); written to launch few
    kernels.
    """
    zero, one, first = _numbers(blurred.dtype, blurred.device)
    a, b, aa, bb, ab = blurred
    luminance = torch.addcmul(first, a, b, value=2)  # (l) 2 a b + C1
    likeness = torch.add((_C1 + _C2) - luminance, ab, alpha=2)  # (s) 2 (ab - a b) + C2
    means = torch.addcmul(torch.addcmul(first, a, a), b, b)  # (m) a^2 + b^2 + C1
    variances = aa + bb - means + (_C1 + _C2)  # (v) aa - a^2 + bb - b^2 + C2
    twice = 2 / (means * variances)
    by_product = luminance * twice
    twice_ssim = by_product * likeness
    pulled = torch.addcmul(b * (likeness - luminance), a, twice_ssim * (means - variances), value=0.5)
    slopes = torch.stack([pulled * twice, torch.addcdiv(zero, twice_ssim, variances, value=-0.5), by_product])
    difference, dissimilarity = (image - target).abs().permute(2, 0, 1), torch.add(one, twice_ssim, alpha=-0.5)
    difference = difference if counted is None else difference * counted.permute(2, 0, 1)
    dissimilarity = dissimilarity if near is None else dissimilarity * near.permute(2, 0, 1)
    return torch.lerp(difference, dissimilarity, weight), slopes


def _slope(
    image: Tensor, target: Tensor, spread: Tensor, inside: Tensor | None, counted: Tensor | None, weight: float
) -> Tensor:
    """[H,W,3] the loss's gradient: of L1, and of -SSIM, whose derivatives `spread` [3,3,H,W] have been blurred."""
    by_mean, by_square, by_product = (part.permute(1, 2, 0) for part in spread)
    similar = torch.addcmul(torch.addcmul(by_mean, image, by_square, value=2), target, by_product)
    sign = (image - target).sign() if counted is None else (image - target).sign() * counted
    numbers = image.numel()
    total = torch.add(sign * ((1 - weight) / numbers), similar, alpha=-weight / numbers)
    return total if inside is None else total * inside


@functools.lru_cache(maxsize=8)
def _numbers(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """[] 0, 1 and SSIM's first constant, made on the device."""
    zero = torch.zeros((), dtype=dtype, device=device)
    return zero, zero + 1, zero + _C1
