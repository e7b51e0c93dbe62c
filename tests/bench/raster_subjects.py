"""What the rasteriser's benchmark measures: a scene of known density, and slower ways to draw it."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.arrays import Float64
from streamlod.core.camera import Camera, pinhole
from streamlod.core.render.reference import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN, project
from streamlod.core.scene.gaussians import GaussianCloud

NAMES = ("means", "quaternions", "scales", "opacities", "colours")
_TILE = 32


def make_scene(count: int, width: int, height: int, seed: int = 0) -> tuple[GaussianCloud, Camera]:
    """Uniform in the frustum, depth log-uniform in 2 to 12, mean 3-sigma radius about 5.7 pixels at any size."""
    g = np.random.default_rng(seed)
    focal = 0.5 * width / math.tan(math.radians(30))
    z = np.exp(g.uniform(np.log(2), np.log(12), count))
    u, v = g.uniform(-0.05, 1.05, count) * width, g.uniform(-0.05, 1.05, count) * height
    points = np.stack([(u - width / 2) / focal * z, (v - height / 2) / focal * z, z], 1)
    yaw, pitch = 0.3, -0.2
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn @ tilt, [0.1, -0.2, 0.5]
    quaternions = g.normal(size=(count, 4))
    sigma = np.exp(g.normal(0, 0.45, (count, 1))) * np.exp(g.normal(0, 0.5, (count, 3)))
    sigma *= 5 / 3 * 0.8 / sigma.mean()
    values: tuple[Float64, ...] = (
        (points - pose[:3, 3]) @ pose[:3, :3],
        quaternions,
        sigma * (z / focal)[:, None],
        1 / (1 + np.exp(-g.normal(0, 2, count))),
        g.uniform(0, 1, (count, 3)),
    )
    cloud = GaussianCloud(*(np.ascontiguousarray(value, np.float32) for value in values))
    return cloud, pinhole("bench", (focal, focal), (width / 2, height / 2), (width, height), pose)


def tensors(cloud: GaussianCloud, gradients: bool = True) -> list[Tensor]:
    """The cloud's parameters as leaves."""
    return [torch.tensor(getattr(cloud, name), requires_grad=gradients) for name in NAMES]


def torch_tiles(parameters: list[Tensor], camera: Camera, background: Tensor) -> Tensor:
    """A plain torch tile rasteriser: one dense blend a tile, differentiated by autograd. Same rules as ours."""
    means, quaternions, scales, opacities, colours = parameters
    mean, covariance, depth = project(means, quaternions, scales, camera)
    with torch.no_grad():
        seen = (depth > 0.01) & (opacities >= ALPHA_MIN)
        reach = 2 * torch.log((opacities * 255).clamp(min=1))
        extent = torch.sqrt(reach[:, None] * torch.diagonal(covariance, dim1=1, dim2=2))
    order = torch.argsort(depth)
    order = order[seen[order]]
    mean, covariance, opacities, colours, extent = (v[order] for v in (mean, covariance, opacities, colours, extent))
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy
    rows = []
    for top in range(0, camera.height, _TILE):
        row = []
        for left in range(0, camera.width, _TILE):
            bottom, right = min(top + _TILE, camera.height), min(left + _TILE, camera.width)
            low, high = mean - extent, mean + extent
            inside = (high[:, 0] >= left) & (low[:, 0] <= right) & (high[:, 1] >= top) & (low[:, 1] <= bottom)
            k = torch.nonzero(inside).squeeze(1)
            y, x = torch.meshgrid(torch.arange(top, bottom) + 0.5, torch.arange(left, right) + 0.5, indexing="ij")
            dx, dy = x.reshape(-1, 1) - mean[k, 0], y.reshape(-1, 1) - mean[k, 1]
            sigma = (0.5 * (yy[k] * dx * dx + xx[k] * dy * dy) - xy[k] * dx * dy) / determinant[k]
            alpha = (opacities[k] * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
            alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
            after = torch.cumprod(1 - alpha, 1)
            before = torch.cat([torch.ones_like(after[:, :1]), after], 1)[:, : len(k)]
            alive = after > TRANSMITTANCE_MIN
            weight = torch.where(alive, alpha * before, torch.zeros_like(alpha))
            light = torch.where(alive, 1 - alpha, torch.ones_like(alpha)).prod(1)
            tile = weight @ colours[k] + light[:, None] * background
            row.append(tile.view(bottom - top, right - left, 3))
        rows.append(torch.cat(row, 1))
    return torch.cat(rows, 0)


def convolution_loss(image: Tensor, target: Tensor, weight: float = 0.2) -> Tensor:
    """L1 + D-SSIM by grouped 11x11 convolutions, as most code of the field has it."""
    line = torch.exp(-((torch.arange(11) - 5.0) ** 2) / 4.5)
    kernel = (torch.outer(line, line) / line.sum() ** 2).expand(3, 1, 11, 11).contiguous()

    def blur(picture: Tensor) -> Tensor:
        return functional.conv2d(picture, kernel, padding=5, groups=3)

    x, y = image.permute(2, 0, 1)[None], target.permute(2, 0, 1)[None]
    a, b = blur(x), blur(y)
    variance_x, variance_y, covariance = blur(x * x) - a * a, blur(y * y) - b * b, blur(x * y) - a * b
    similar = ((2 * a * b + 1e-4) * (2 * covariance + 9e-4)) / (
        (a * a + b * b + 1e-4) * (variance_x + variance_y + 9e-4)
    )
    return (1 - weight) * (image - target).abs().mean() + weight * (1 - similar.mean())
