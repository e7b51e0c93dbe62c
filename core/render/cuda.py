"""Rasterising on a GPU with gsplat 1.5 (Ye et al., gsplat, JMLR 2025), behind the interface of the CPU kernels."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from core.camera import Camera
from core.errors import BackendUnavailable
from core.render.backends import cuda_fault
from core.render.raster import Probe, Raster
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH

# The image model, as in `core.render.cpu.kernels.inline.constants`; alpha's limits are built into gsplat.
_RULES = {"near_plane": 0.01, "far_plane": 1e10, "eps2d": 0.1, "rasterize_mode": "classic", "packed": True}
_OPACITY_MAX = 2.0
_MAX_PARAMETER = 1e15  # of a parameter; the picture's arithmetic overflows some way beyond
_MAX_SCALE_PIXELS = 1e8  # of a scale in the picture: fourth powers of it must fit into float32
_NEAR = 0.01
_MAX_ASIDE, _MAX_SLOPE, _MAX_SPREAD = 1.0, 1.0, 0.5


def rasterise_cuda(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    camera: Camera,
    background: Tensor,
    gradient_rows: int | None,
    tile_mask: Tensor | None,
    base: Tensor | None,
) -> Raster:
    """`core.render.differentiable.rasterise` with gsplat; arguments as there, tensors on a CUDA device.

    Raises:
        BackendUnavailable: no device, no gsplat, or one of another interface.
    """
    rasterization, count = _gsplat(), len(means)
    moving = count if gradient_rows is None else gradient_rows
    parameters = [means, quaternions, scales, opacities, colours]
    if count == 0:  # gsplat's kernels want at least one Gaussian
        return _empty(means, camera, background, tile_mask, base)
    pose, intrinsics, centre, half = _on_device(camera, means.device)
    parameters = sound(parameters, pose, intrinsics, centre, half, moving)
    images, alphas, meta = rasterization(
        *parameters,
        viewmats=pose[None],
        Ks=intrinsics[None],
        width=camera.width,
        height=camera.height,
        **_RULES,
    )
    # the background not by gsplat, whose packed mode refuses one (1.5.3: it looks for the cameras in `means2d`)
    # squeezed rather than indexed: the gradient of an index is a new picture
    drawn = images.squeeze(0), alphas.squeeze(0).squeeze(-1)
    image, light = _Behind.apply(*drawn, background)  # type: ignore[no-untyped-call]
    rows = meta["gaussian_ids"].long()
    probe = Probe(rows, None if moving == count else rows < moving)
    if (projected := meta["means2d"]).requires_grad:
        # it must not know of `projected`: such a circle keeps all that the picture took until Python looks for circles
        projected.register_hook(partial(probe.record, scale=half))
    if tile_mask is not None:
        image, light = _over(image, light, tile_mask, base)
    return Raster(image, light, probe)


def sound(
    parameters: list[Tensor], pose: Tensor, intrinsics: Tensor, centre: Tensor, half: Tensor, moving: int | None = None
) -> list[Tensor]:
    """The five parameters with those Gaussians moved out of sight that gsplat cannot draw, or should not.

    What is not finite, has no direction, is so large that projecting it overflows, lies far beside the picture or
    reaches too far along the view comes to lie in the camera's centre, and gets no gradient; the CPU kernels leave the
    same out. Opacities count as at most 2, their gradients go on as though they were not held.

    Args:
        parameters: as `rasterise_cuda` takes them.
        pose [4,4], intrinsics [3,3], centre [3]: of the camera. half: [2] half the size of its picture, in pixels.
        moving: how many of the first rows get gradients; all by default.
    """
    return list(_Sound.apply(*parameters, pose, intrinsics, centre, half, moving))  # type: ignore[no-untyped-call]


def _held(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    pose: Tensor,
    intrinsics: Tensor,
    centre: Tensor,
    half: Tensor,
) -> tuple[Tensor, ...]:
    """[N] bool which Gaussians can be drawn, and the five parameters as `sound` gives them."""
    largest = torch.maximum(means.abs().amax(dim=1), quaternions.abs().amax(dim=1))
    largest = torch.maximum(largest, torch.maximum(colours.abs().amax(dim=1), opacities.abs()))
    scale = scales.abs().amax(dim=1)
    at_camera = (means[:, None] * pose[:3, :3]).sum(dim=2) + pose[:3, 3]
    depth = at_camera[:, 2].clamp_min(_NEAR)
    slope = at_camera[:, :2] / depth[:, None]
    place = torch.addcmul(intrinsics[:2, 2], slope, intrinsics.diagonal()[:2])  # pixels
    aside = (place / half - 1).abs().amax(dim=1)  # from the picture's middle, in half pictures
    length = torch.linalg.vector_norm(quaternions, dim=1)
    size = scale * torch.maximum(intrinsics[0, 0], intrinsics[1, 1]) / depth
    good = torch.maximum(largest, scale) < _MAX_PARAMETER  # false for NaN too
    good = good & ((aside <= 2 * _MAX_ASIDE) | (torch.linalg.vector_norm(slope, dim=1) <= _MAX_SLOPE))
    good = good & (_spread(quaternions / length[:, None], scales, pose[2, :3]) <= _MAX_SPREAD * depth)
    good = good & (size < _MAX_SCALE_PIXELS)
    rows = good[:, None]
    upright = (torch.arange(4, device=means.device) == 0).to(means.dtype)
    one, zero = upright[0], upright[1]  # rather than numbers, each of which torch sends to the device
    return (
        good,
        torch.where(rows, means, centre),
        torch.where(rows, quaternions, upright),
        torch.where(rows, scales, one),
        torch.where(good, opacities.clamp(max=_OPACITY_MAX), zero),
        torch.where(rows, colours, zero),
    )


def _spread(rotations: Tensor, scales: Tensor, ahead: Tensor) -> Tensor:
    """[N] standard deviations along `ahead` [3] of Gaussians with unit quaternions `rotations` [N,4], NaN without one.

    They are those of the direction in each Gaussian's own axes.
    """
    real, imaginary, ahead = rotations[:, :1], rotations[:, 1:], ahead.expand(len(rotations), 3)
    turned = 2 * torch.linalg.cross(imaginary, ahead)
    own = torch.addcmul(ahead, real, turned, value=-1) + torch.linalg.cross(imaginary, turned)
    spread: Tensor = torch.linalg.vector_norm(own * scales, dim=1)
    return spread


def _of_sound(good: Tensor, moving: int, *gradients: Tensor) -> tuple[Tensor, ...]:
    """`gradients` of the five parameters, zero for Gaussians not `good` [N] or not among the first `moving`."""
    wanted = good if moving == len(good) else good & (torch.arange(len(good), device=good.device) < moving)
    zero = torch.zeros((), dtype=gradients[0].dtype, device=good.device)
    return tuple(torch.where(wanted if part.ndim == 1 else wanted[:, None], part, zero) for part in gradients)


class _Sound(torch.autograd.Function):
    """`sound` in few launches."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> tuple[Tensor, ...]:
        good, *held = _held(*given[:9])
        ctx.good, ctx.moving = good, len(good) if given[9] is None else given[9]
        return tuple(held)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        return (*_of_sound(ctx.good, ctx.moving, *upstream), None, None, None, None, None)


class _Behind(torch.autograd.Function):
    """A picture [H,W,3] with a background [3] where its coverage [H,W] lets it show, and the transmittance [H,W]."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, coverage: Tensor, background: Tensor) -> tuple[Tensor, Tensor]:
        ctx.background = background
        ctx.set_materialize_grads(False)
        light = 1 - coverage
        return torch.addcmul(image, light[..., None], background), light

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, by_image: Tensor | None, by_light: Tensor | None) -> tuple[Tensor | None, ...]:
        by_coverage = None if by_image is None else by_image @ -ctx.background
        if by_light is not None:
            by_coverage = -by_light if by_coverage is None else by_coverage - by_light
        return by_image, by_coverage, None


def _over(image: Tensor, light: Tensor, tile_mask: Tensor, base: Tensor | None) -> tuple[Tensor, Tensor]:
    """The picture inside the mask, `base` outside; gradients stop at the mask's edge."""
    pixels = tile_mask.repeat_interleave(TILE_HEIGHT, 0).repeat_interleave(TILE_WIDTH, 1)
    pixels = pixels[: image.shape[0], : image.shape[1]]
    under = torch.zeros_like(image) if base is None else base
    return torch.where(pixels[..., None], image, under), torch.where(pixels, light, torch.ones_like(light))


def _empty(means: Tensor, camera: Camera, background: Tensor, tile_mask: Tensor | None, base: Tensor | None) -> Raster:
    image = background.expand(camera.height, camera.width, 3).contiguous()
    light = torch.ones(camera.height, camera.width, device=means.device)
    if tile_mask is not None:
        image, light = _over(image, light, tile_mask, base)
    return Raster(image, light, Probe(torch.zeros(0, dtype=torch.int64, device=means.device)))


@functools.lru_cache(maxsize=64)
def _on_device(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Pose [4,4], intrinsics [3,3], centre [3] and half the size [2] in pixels.

    Kept, because sending them each time would make the host wait for the device.
    """
    parts = (camera.world_to_camera, camera.intrinsics, camera.centre, [camera.width / 2, camera.height / 2])
    numbers = np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)
    sent = torch.from_numpy(numbers).to(device, non_blocking=True)
    pose, intrinsics, centre, half = torch.split(sent, [16, 9, 3, 2])
    return pose.view(4, 4), intrinsics.view(3, 3), centre, half


@functools.cache
def _gsplat() -> Callable[..., Any]:
    """gsplat's `rasterization`, after looking at whether it is the one that this module was written for."""
    fault = cuda_fault()
    if fault is not None:
        raise BackendUnavailable("the cuda backend", fault)
    rasterization: Callable[..., Any] = importlib.import_module("gsplat").rasterization
    lacking = _RULES.keys() - set(inspect.signature(rasterization).parameters)
    if lacking:
        raise BackendUnavailable(
            "the cuda backend", f"this gsplat lacks {', '.join(sorted(lacking))}: install gsplat>=1.5.3,<1.6"
        )
    return rasterization
