"""Which Gaussians gsplat can draw, and should; the others are moved out of sight before it gets them.

Written to launch few kernels: on a GPU, launching them takes longer than their arithmetic (docs/history/benchmarks.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera

_OPACITY_MAX = 2.0
_MAX_PARAMETER = 1e15  # of a parameter; the picture's arithmetic overflows some way beyond
_MAX_SCALE_PIXELS = 1e8  # of a scale in the picture: fourth powers of it must fit into float32
_NEAR = 0.01
_MAX_ASIDE, _MAX_SLOPE, _MAX_SPREAD = 1.0, 1.0, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class DeviceCamera:
    """A camera as `drawable` and gsplat need it, float32 on the device.

    Attributes:
        pose: [4,4] from the world to the camera. intrinsics: [3,3]. centre: [3] in the world. half: [2] pixels, half
            the size of the picture.
        rotation, translation: [3,3] and [3]; means [N,3] @ rotation + translation are in camera coordinates.
        slope_scale, slope_offset: [2]; (x/z, y/z) * slope_scale + slope_offset is the distance from the picture's
            middle, in half pictures.
        axis_products: [16,3]; the products q_i q_j of a unit quaternion @ axis_products are the view's axis in the
            Gaussian's own coordinates.
        scale_limit: [] largest scale a unit of depth.
        identity: [4] the quaternion of no rotation. one, zero: [].
    """

    pose: Tensor
    intrinsics: Tensor
    centre: Tensor
    half: Tensor
    rotation: Tensor
    translation: Tensor
    slope_scale: Tensor
    slope_offset: Tensor
    axis_products: Tensor
    scale_limit: Tensor
    identity: Tensor
    one: Tensor
    zero: Tensor


def device_camera(camera: Camera, device: torch.device) -> DeviceCamera:
    """`camera` on `device`, in one copy that nobody waits for."""
    pose, intrinsics = camera.world_to_camera, camera.intrinsics
    half, focal = np.array([camera.width, camera.height]) / 2, intrinsics.diagonal()[:2]
    parts = {
        "pose": pose,
        "intrinsics": intrinsics,
        "centre": camera.centre,
        "half": half,
        "rotation": pose[:3, :3].T,
        "translation": pose[:3, 3],
        "slope_scale": focal / half,
        "slope_offset": intrinsics[:2, 2] / half - 1,
        "axis_products": _axis_products(pose[2, :3]),
        "scale_limit": np.array(_MAX_SCALE_PIXELS / focal.max()),
        "identity": np.array([1, 0, 0, 0]),
        "one": np.array(1),
        "zero": np.array(0),
    }
    numbers = np.concatenate([part.ravel() for part in parts.values()]).astype(np.float32)
    sent = torch.split(torch.from_numpy(numbers).to(device, non_blocking=True), [part.size for part in parts.values()])
    return DeviceCamera(**{name: one.view(part.shape) for (name, part), one in zip(parts.items(), sent, strict=True)})


def drawable(parameters: list[Tensor], camera: DeviceCamera, moving: int | None = None) -> list[Tensor]:
    """The five parameters with those Gaussians moved out of sight that gsplat cannot draw, or should not.

    What is not finite, has no direction, is so large that projecting it overflows, lies far beside the picture or
    reaches too far along the view comes to lie in the camera's centre, and gets no gradient; the CPU kernels leave the
    same out. Opacities count as at most 2, their gradients go on as though they were not held.

    Args:
        parameters: as `core.render.cuda.rasterise_cuda` takes them.
        moving: how many of the first rows get gradients; all by default.
    """
    return list(_Drawable.apply(*parameters, camera, moving))  # type: ignore[no-untyped-call]


def _is_drawable(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, colours: Tensor, camera: DeviceCamera
) -> Tensor:
    """[N] bool which Gaussians can be drawn; every comparison is false for NaN."""
    sizes = torch.cat([scales, means, quaternions, colours, opacities[:, None]], dim=1).abs()
    at_camera = torch.addmm(camera.translation, means, camera.rotation)
    depth = at_camera[:, 2].clamp_min(_NEAR)
    slope = at_camera[:, :2] / depth[:, None]
    aside = torch.addcmul(camera.slope_offset, slope, camera.slope_scale).abs().amax(dim=1)
    near_by = (aside <= 2 * _MAX_ASIDE) | (torch.linalg.vector_norm(slope, dim=1) <= _MAX_SLOPE)
    small = (sizes.amax(dim=1) < _MAX_PARAMETER) & (sizes[:, :3].amax(dim=1) < camera.scale_limit * depth)
    good: Tensor = near_by & small & (_spread(quaternions, scales, camera) <= _MAX_SPREAD * depth)
    return good


def _spread(quaternions: Tensor, scales: Tensor, camera: DeviceCamera) -> Tensor:
    """[N] standard deviations of Gaussians along the view, NaN without a direction."""
    unit = quaternions / torch.linalg.vector_norm(quaternions, dim=1, keepdim=True)
    own = (unit[:, :, None] * unit[:, None]).flatten(1) @ camera.axis_products
    spread: Tensor = torch.linalg.vector_norm(own * scales, dim=1)
    return spread


def _axis_products(axis: Float64) -> Float64:
    """[16,3] by which the products q_i q_j of a unit quaternion (w x y z) give `axis` [3] turned back by it."""
    x, y, z = axis
    # R(q)^T axis = (w^2 - v.v) axis + 2 v (v.axis) - 2 w (v x axis)
    products = np.zeros((4, 4, 3))
    products[0, 0] = axis
    for i in range(3):
        products[1 + i, 1 + i] -= axis
        for j in range(3):
            products[1 + i, 1 + j, i] += 2 * axis[j]
    products[0, 1] = -2 * np.array([0, -z, y])
    products[0, 2] = -2 * np.array([z, 0, -x])
    products[0, 3] = -2 * np.array([-y, x, 0])
    return products.reshape(16, 3)


class _Drawable(torch.autograd.Function):
    """`drawable`, the gradient written down."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> tuple[Tensor, ...]:
        means, quaternions, scales, opacities, colours, camera, moving = given
        good = wanted = _is_drawable(means, quaternions, scales, opacities, colours, camera)
        if moving is not None and moving < len(good):
            wanted = torch.zeros_like(good)
            wanted[:moving] = good[:moving]
        ctx.wanted, ctx.zero = wanted, camera.zero
        rows = good[:, None]
        return (
            torch.where(rows, means, camera.centre),
            torch.where(rows, quaternions, camera.identity),
            torch.where(rows, scales, camera.one),
            torch.where(good, opacities.clamp(max=_OPACITY_MAX), camera.zero),
            torch.where(rows, colours, camera.zero),
        )

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        rows = ctx.wanted[:, None]
        found = (torch.where(rows if part.ndim > 1 else ctx.wanted, part, ctx.zero) for part in upstream)
        return (*found, None, None)
