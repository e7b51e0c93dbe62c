"""Small scenes, and how to push them through a backend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.render import Backend, rasterise
from streamlod.core.render.raster import Probe
from streamlod.core.scene.gaussians import GaussianCloud

NAMES = ("means", "quaternions", "scales", "opacities", "colours")
BACKGROUND = np.array([0.1, 0.2, 0.3], np.float32)


def make_camera(width: int = 48, height: int = 40, focal: float | None = None) -> Camera:
    """A camera that looks from a skew angle at the origin, five units away."""
    focal = focal or 0.9 * width
    pose = look_at(np.array([2.0, -1.5, -4.3]), np.zeros(3), np.array([0.1, -1.0, 0.0]))
    return pinhole("test", (focal, 1.05 * focal), (0.48 * width, 0.53 * height), (width, height), pose)


def make_cloud(count: int = 60, seed: int = 0, size: float = 0.15, spread: float = 1.2) -> GaussianCloud:
    """Gaussians of any shape, weak and strong, about the origin."""
    g = np.random.default_rng(seed)
    values: tuple[Float64, ...] = (
        g.normal(0, spread, (count, 3)),
        g.normal(size=(count, 4)),
        size * np.exp(g.normal(0, 0.6, (count, 3))),
        1 / (1 + np.exp(-g.normal(0.5, 2, count))),
        g.uniform(0, 1, (count, 3)),
    )
    return GaussianCloud(*(np.ascontiguousarray(v, np.float32) for v in values))


@dataclass(frozen=True)
class Outcome:
    """A picture [H,W,3], its transmittance [H,W] and the gradients of a random linear loss, by name; all float64."""

    image: Tensor
    transmittance: Tensor
    gradients: dict[str, Tensor]
    probe: Probe


def run(
    cloud: GaussianCloud,
    camera: Camera,
    backend: Backend = "cpu",
    gradient_rows: int | None = None,
    device: str = "cpu",
) -> Outcome:
    """Render and differentiate `cloud` under a loss that weighs every pixel and the transmittance at random."""
    dtype = torch.float64 if backend == "reference" else torch.float32
    parameters = [torch.tensor(getattr(cloud, name), dtype=dtype).to(device).requires_grad_() for name in NAMES]
    raster = rasterise(
        *parameters,
        camera,
        torch.tensor(BACKGROUND, dtype=dtype, device=device),
        gradient_rows=gradient_rows,
        backend=backend,
    )
    g = np.random.default_rng(9)
    weights = torch.tensor(g.normal(size=(camera.height, camera.width, 4)), dtype=dtype, device=device)
    loss = (raster.image * weights[..., :3]).sum() + (raster.transmittance * weights[..., 3]).sum()
    if loss.requires_grad:
        loss.backward()
    gradients = {
        name: torch.zeros_like(p).double().cpu() if p.grad is None else p.grad.double().cpu()
        for name, p in zip(NAMES, parameters, strict=True)
    }
    return Outcome(
        raster.image.detach().double().cpu(), raster.transmittance.detach().double().cpu(), gradients, raster.probe
    )


def relative(found: Tensor, wanted: Tensor) -> float:
    """|found - wanted| / |wanted|."""
    return float((found - wanted).norm() / wanted.norm().clamp(min=1e-30))
