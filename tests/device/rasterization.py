"""gsplat's `rasterization` for the pretend device: its signature and `meta`, the arithmetic of our CPU kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from streamlod.core.camera import pinhole
from streamlod.core.render import Raster, rasterise
from tests.device.pretend import DeviceTensor

# Parameters of gsplat 1.5.3's rasterization, in order; tests compare them with the package where it is installed.
PARAMETERS = (
    "means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "width", "height", "near_plane", "far_plane",
    "radius_clip", "eps2d", "sh_degree", "packed", "tile_size", "backgrounds", "render_mode", "sparse_grad", "absgrad",
    "rasterize_mode", "channel_chunk", "distributed", "camera_model", "segmented", "covars", "with_ut", "with_eval3d",
    "radial_coeffs", "tangential_coeffs", "thin_prism_coeffs", "ftheta_coeffs", "rolling_shutter", "viewmats_rs",
)  # fmt: skip


def rasterization(
    means: Tensor,  # [N,3]
    quats: Tensor,  # [N,4]
    scales: Tensor,  # [N,3]
    opacities: Tensor,  # [N]
    colors: Tensor,  # [N,3]
    viewmats: Tensor,  # [1,4,4]
    Ks: Tensor,  # [1,3,3]  # noqa: N803  gsplat's name
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    eps2d: float = 0.3,
    packed: bool = True,
    rasterize_mode: str = "classic",
) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
    """([1,H,W,3] image, [1,H,W,1] alpha, meta with packed `gaussian_ids` [V] and `means2d` [V,2]) of one camera."""
    assert packed
    assert (near_plane, far_plane, eps2d, rasterize_mode) == (0.01, 1e10, 0.1, "classic")
    given = (means, quats, scales, opacities, colors)
    assert all(isinstance(value, DeviceTensor) for value in (*given, viewmats, Ks)), "a tensor is not on the device"
    pose, matrix = (value.held[0].double().numpy() for value in (viewmats, Ks))  # type: ignore[attr-defined]
    camera = pinhole("gsplat", tuple(matrix.diagonal()[:2]), tuple(matrix[:2, 2]), (width, height), pose)
    leaves = [value.held.detach().clone().requires_grad_() for value in given]  # type: ignore[attr-defined]
    with torch.enable_grad():
        raster = rasterise(*leaves, camera, torch.zeros(3))
        alpha = 1 - raster.transmittance
    rows = raster.probe.visible
    projected = DeviceTensor(torch.zeros(len(rows), 2))
    if torch.is_grad_enabled() and any(value.requires_grad for value in given):
        projected.requires_grad_()
    drawn = _Drawn(leaves, raster, alpha, torch.tensor([width / 2, height / 2]))
    image, coverage = _Kernels.apply(drawn, projected, *given)
    return image[None], coverage[None, ..., None], {"gaussian_ids": DeviceTensor(rows), "means2d": projected}


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A picture on the host with its graph; hidden from the device's graph."""

    leaves: list[Tensor]
    raster: Raster
    alpha: Tensor
    half: Tensor


class _Kernels(torch.autograd.Function):
    """A picture drawn on the CPU as an operation of the device."""

    @staticmethod
    def forward(ctx: Any, drawn: _Drawn, projected: Tensor, *given: Tensor) -> tuple[Tensor, Tensor]:
        ctx.drawn = drawn
        return DeviceTensor(drawn.raster.image.detach().clone()), DeviceTensor(drawn.alpha.detach().clone())

    @staticmethod
    def backward(ctx: Any, by_image: DeviceTensor, by_alpha: DeviceTensor) -> tuple[Any, ...]:  # type: ignore[override]
        drawn: _Drawn = ctx.drawn
        torch.autograd.backward((drawn.raster.image, drawn.alpha), (by_image.held, by_alpha.held))
        pulls = drawn.raster.probe.gradients / drawn.half
        return (None, DeviceTensor(pulls), *(DeviceTensor(leaf.grad) for leaf in drawn.leaves if leaf.grad is not None))
