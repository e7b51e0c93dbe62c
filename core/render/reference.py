"""The oracle: every pixel meets every Gaussian, in float64, differentiated by torch. Small pictures only.

Mirrors `core.render.cpu.kernels` rule by rule, as plainly as can be said.
"""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.render.raster import Probe, Raster

ALPHA_MIN, ALPHA_MAX = 1 / 255, 0.999
OPACITY_MAX = 2.0
TRANSMITTANCE_MIN = 1e-4
NEAR, FAR = 0.01, 1e10
MAX_ASIDE, MAX_SLOPE = 1.0, 1.0
MAX_SPREAD = 0.5
LOW_PASS = 0.1
FIELD_MARGIN = 0.3
COLOUR_MAX = 1e15
FINITE = 1e30


def rasterise_reference(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    camera: Camera,
    background: Tensor,
    gradient_rows: int | None,
) -> Raster:
    """`core.render.differentiable.rasterise` by brute force; arguments as there, float64 allowed and kept."""
    moving = len(means) if gradient_rows is None else gradient_rows
    given = [torch.cat([p[:moving], p[moving:].detach()]) for p in (means, quaternions, scales, opacities, colours)]
    with torch.no_grad():
        m, q, s, o, c = (p.double() for p in given)
        rows = _visible(m, q, s, o, c, camera)
    m, q, s, o, c = (p[rows].double() for p in given)
    mean, covariance, depth = project(m, q, s, camera)
    probe = Probe(rows[rows < moving])
    if mean.requires_grad:
        half = mean.new_tensor([camera.width / 2, camera.height / 2])

        def record(gradients: Tensor | None) -> None:
            if gradients is not None:  # gradcheck passes none on purpose
                probe.record((gradients[: len(probe.visible)] * half).float())

        mean.register_hook(record)  # type: ignore[no-untyped-call]
    order = torch.argsort(depth, stable=True)
    image, light = blend(
        mean[order], covariance[order], o[order], c[order], background.double(), camera.width, camera.height
    )
    return Raster(image.to(means.dtype), light.to(means.dtype), probe)


def project(means: Tensor, quaternions: Tensor, scales: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Means [N,2] and low-passed covariances [N,2,2] in pixels, depths [N] (Zwicker et al. 2002, section 4)."""
    pose = torch.as_tensor(camera.world_to_camera, dtype=means.dtype)
    k = camera.intrinsics
    fx, fy, cx, cy = float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])
    point = means @ pose[:3, :3].T + pose[:3, 3]
    z = point[:, 2]
    slope_x, slope_y = point[:, 0] / z, point[:, 1] / z
    margin_x, margin_y = FIELD_MARGIN * 0.5 * camera.width / fx, FIELD_MARGIN * 0.5 * camera.height / fy
    held_x = slope_x.clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    held_y = slope_y.clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * held_x / z, zero, fy / z, -fy * held_y / z], -1).view(-1, 2, 3)
    half = jacobian @ pose[:3, :3] @ (rotation(quaternions) * scales[:, None, :])
    covariance = half @ half.transpose(1, 2) + LOW_PASS * torch.eye(2, dtype=means.dtype)
    return torch.stack([fx * slope_x + cx, fy * slope_y + cy], -1), covariance, z


def rotation(quaternions: Tensor) -> Tensor:
    """[N,3,3] matrices of quaternions [N,4], w x y z, of any length."""
    w, x, y, z = (quaternions / quaternions.norm(dim=-1, keepdim=True)).unbind(-1)
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(entries, -1).view(-1, 3, 3)


def blend(
    mean: Tensor, covariance: Tensor, opacity: Tensor, colour: Tensor, background: Tensor, width: int, height: int
) -> tuple[Tensor, Tensor]:
    """Picture [H,W,3] and transmittance [H,W] of projected Gaussians, near to far (Kerbl et al. 2023, equation 3)."""
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy
    rows, columns = (torch.arange(n, dtype=mean.dtype) + 0.5 for n in (height, width))
    dx = columns.repeat(height)[:, None] - mean[None, :, 0]
    dy = rows.repeat_interleave(width)[:, None] - mean[None, :, 1]
    sigma = (0.5 * (yy * dx * dx + xx * dy * dy) - xy * dx * dy) / determinant
    opacity = opacity + (opacity.clamp(max=OPACITY_MAX) - opacity).detach()  # its gradient goes on as though unclamped
    alpha = (opacity * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
    after = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    reached = after > TRANSMITTANCE_MIN
    weight = torch.where(reached, alpha * before, torch.zeros_like(alpha))
    light = torch.where(reached, 1 - alpha, torch.ones_like(alpha)).prod(1)
    image = weight @ colour + light[:, None] * background
    return image.view(height, width, 3), light.view(height, width)


def _visible(
    means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor, colours: Tensor, camera: Camera
) -> Tensor:
    """[M] int64 rows that a backend draws: finite, in front, strong enough, reaching a pixel centre."""
    mean, covariance, z = project(means, quaternions, scales, camera)
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy
    size, colour = mean.abs().sum(-1) + determinant, colours.abs().sum(-1)
    picture = mean.new_tensor([camera.width, camera.height])
    pose = torch.as_tensor(camera.world_to_camera, dtype=means.dtype)
    slope = (means @ pose[:2, :3].T + pose[:2, 3]).norm(dim=-1) / z
    spread = ((pose[2, :3] @ rotation(quaternions)) * scales).norm(dim=-1)
    good = (
        (z > NEAR)
        & (z < FAR)
        & (((mean / picture - 0.5).abs() <= MAX_ASIDE).all(-1) | (slope <= MAX_SLOPE))
        & (spread <= MAX_SPREAD * z)
        & (opacities >= ALPHA_MIN)
        & (opacities < FINITE)
        & (determinant > 1e-12)
        & (size < FINITE)
        & (colour < COLOUR_MAX)
    )
    reach = (2 * torch.log(opacities.clamp(max=OPACITY_MAX) * 255)).clamp(min=0)
    extent = torch.sqrt(reach[:, None] * torch.stack([xx, yy], -1))
    first = torch.ceil((mean - extent - 0.5).clamp(min=0))
    last = torch.floor(torch.minimum(mean + extent - 0.5, picture - 1))
    return torch.nonzero(good & (last >= first).all(-1)).squeeze(1)
