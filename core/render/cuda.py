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
_NEEDED = {*_RULES, "backgrounds", "absgrad"}


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
    pose, intrinsics = _on_device(camera, means.device)
    parameters[3] = parameters[3].clamp(max=_OPACITY_MAX)
    images, alphas, meta = rasterization(
        *parameters,
        viewmats=pose[None],
        Ks=intrinsics[None],
        width=camera.width,
        height=camera.height,
        backgrounds=background[None],
        absgrad=True,
        **_RULES,
    )
    image, light = images[0], 1 - alphas[0, ..., 0]
    rows = meta["gaussian_ids"].long()
    wanted = rows < moving
    probe = Probe(rows[wanted])
    projected = meta["means2d"]
    if projected.requires_grad:
        half = projected.new_tensor([camera.width / 2, camera.height / 2])

        def record(gradients: Tensor) -> None:
            absolute = getattr(projected, "absgrad", None)
            probe.record(gradients[wanted] * half, None if absolute is None else absolute[wanted] * half)

        projected.register_hook(record)
    if tile_mask is not None:
        image, light = _over(image, light, tile_mask, base)
    return Raster(image, light, probe)


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
def _on_device(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor]:
    """Pose [4,4] and intrinsics [3,3]; kept, because sending them each time would make the host wait for the device."""
    return (
        torch.as_tensor(camera.world_to_camera, dtype=torch.float32, device=device),
        torch.as_tensor(camera.intrinsics, dtype=torch.float32, device=device),
    )


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
