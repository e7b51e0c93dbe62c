"""Rasterising on a GPU with gsplat 1.5 (Ye et al., gsplat, JMLR 2025), behind the interface of the CPU kernels."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from core.camera import Camera
from core.errors import BackendUnavailable
from core.render.backends import cuda_fault
from core.render.raster import Probe, Raster
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH

# The image model, as in `core.render.cpu.kernels.inline.constants`; alpha's limits are built into gsplat.
_RULES = {"near_plane": 0.01, "far_plane": 1e10, "eps2d": 0.3, "rasterize_mode": "classic", "packed": True}
_OPACITY_MAX = 2.0
_MAX_PARAMETER = 1e15  # of a parameter; the picture's arithmetic overflows some way beyond
_MAX_SCALE_PIXELS = 1e8  # of a scale in the picture: fourth powers of it must fit into float32
_NEAR = 0.01
_NEEDED = {*_RULES, "absgrad"}


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
    if moving < count:
        parameters = [torch.cat([p[:moving], p[moving:].detach()]) for p in parameters]
    if count == 0:  # gsplat's kernels want at least one Gaussian
        return _empty(means, camera, background, tile_mask, base)
    pose, intrinsics, centre, half = _on_device(camera, means.device)
    parameters = sound(parameters, pose, intrinsics, centre)
    images, alphas, meta = rasterization(
        *parameters,
        viewmats=pose[None],
        Ks=intrinsics[None],
        width=camera.width,
        height=camera.height,
        absgrad=True,
        **_RULES,
    )
    light = 1 - alphas[0, ..., 0]
    # not by gsplat, whose packed mode refuses a background a camera (1.5.3: it looks for the cameras in `means2d`)
    image = images[0] + light[..., None] * background
    rows = meta["gaussian_ids"].long()
    probe = Probe(rows, None if moving == count else rows < moving)
    projected = meta["means2d"]
    if projected.requires_grad:

        def record(gradients: Tensor) -> None:
            absolute = getattr(projected, "absgrad", None)
            probe.record(gradients * half, None if absolute is None else absolute * half)

        projected.register_hook(record)
    if tile_mask is not None:
        image, light = _over(image, light, tile_mask, base)
    return Raster(image, light, probe)


def sound(parameters: list[Tensor], pose: Tensor, intrinsics: Tensor, centre: Tensor) -> list[Tensor]:
    """The five parameters with those Gaussians moved out of sight that gsplat's kernels cannot draw.

    What is not finite, has no direction, or is so large that projecting it overflows, comes to lie in the camera's
    centre, and gets no gradient; the CPU kernels leave the same out. Opacities count as at most 2, their gradients go
    on as though they were not held.

    Args:
        parameters: as `rasterise_cuda` takes them.
        pose [4,4], intrinsics [3,3], centre [3]: of the camera.
    """
    means, quaternions, scales, opacities, colours = parameters
    with torch.no_grad():
        flat = torch.cat([means, quaternions, scales, opacities[:, None], colours], dim=1)
        depth = (means @ pose[2, :3] + pose[2, 3]).clamp_min(_NEAR)
        size = scales.abs().amax(dim=1) * intrinsics.diagonal()[:2].amax() / depth
        length = quaternions.square().sum(dim=1)
        good = (flat.abs() < _MAX_PARAMETER).all(dim=1) & (size < _MAX_SCALE_PIXELS) & (length > 0)
        upright = torch.eye(4, device=means.device)[0]
        excess = opacities - opacities.clamp(max=_OPACITY_MAX)
    rows = good[:, None]
    return [
        torch.where(rows, means, centre),
        torch.where(rows, quaternions, upright),
        torch.where(rows, scales, torch.ones_like(scales)),
        torch.where(good, opacities - excess, torch.zeros_like(opacities)),
        torch.where(rows, colours, torch.zeros_like(colours)),
    ]


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
    half = [camera.width / 2, camera.height / 2]
    parts = (camera.world_to_camera, camera.intrinsics, camera.centre, half)
    pose, intrinsics, centre, size = (torch.as_tensor(part, dtype=torch.float32).to(device) for part in parts)
    return pose, intrinsics, centre, size


@functools.cache
def _gsplat() -> Callable[..., Any]:
    """gsplat's `rasterization`, after looking at whether it is the one that this module was written for."""
    fault = cuda_fault()
    if fault is not None:
        raise BackendUnavailable("the cuda backend", fault)
    rasterization: Callable[..., Any] = importlib.import_module("gsplat").rasterization
    lacking = _NEEDED - set(inspect.signature(rasterization).parameters)
    if lacking:
        raise BackendUnavailable(
            "the cuda backend", f"this gsplat lacks {', '.join(sorted(lacking))}: install gsplat>=1.5.3,<1.6"
        )
    return rasterization
