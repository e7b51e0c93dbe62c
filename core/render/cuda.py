"""Rasterising on a GPU with gsplat 1.5 (Ye et al., gsplat, JMLR 2025), behind the interface of the CPU kernels."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.errors import BackendUnavailable
from streamlod.core.render.backends import cuda_fault
from streamlod.core.render.drawable import device_camera, drawable
from streamlod.core.render.raster import Probe, Raster

# The image model, as in `core.render.cpu.kernels.inline.constants`; alpha's limits are built into gsplat.
_RULES = {"near_plane": 0.01, "far_plane": 1e10, "eps2d": 0.1, "rasterize_mode": "classic", "packed": True}


def rasterise_cuda(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    camera: Camera,
    background: Tensor,
    gradient_rows: int | None,
) -> Raster:
    """`core.render.differentiable.rasterise` with gsplat; arguments as there, tensors on a CUDA device.

    Raises:
        BackendUnavailable: no device, no gsplat, or one of another interface.
    """
    rasterization, count = _gsplat(), len(means)
    moving = count if gradient_rows is None else gradient_rows
    parameters = [means, quaternions, scales, opacities, colours]
    if count == 0:  # gsplat's kernels want at least one Gaussian
        return _empty(means, camera, background)
    on_device = _device_camera(camera, means.device)
    parameters = drawable(parameters, on_device, moving)
    images, alphas, meta = rasterization(
        *parameters,
        viewmats=on_device.pose[None],
        Ks=on_device.intrinsics[None],
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
        # without `projected` in it: that reference cycle would keep the picture's memory until Python collects garbage
        projected.register_hook(partial(probe.record, scale=on_device.half))
    return Raster(image, light, probe)


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


def _empty(means: Tensor, camera: Camera, background: Tensor) -> Raster:
    image = background.expand(camera.height, camera.width, 3).contiguous()
    light = torch.ones(camera.height, camera.width, device=means.device)
    return Raster(image, light, Probe(torch.zeros(0, dtype=torch.int64, device=means.device)))


_device_camera = functools.lru_cache(maxsize=64)(device_camera)  # sending it each time would make the host wait


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
