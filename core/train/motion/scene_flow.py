"""How far anchors went in space, from how far they went in the pictures of all cameras (Vedula et al. 1999)."""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.train.motion.optical_flow import AnchorFlow

_ROUNDS = 3  # of reweighting
_DOUBT = 0.5  # pixels of disagreement with the other cameras, at which a camera's flow counts half
_STIFFNESS = 0.03  # of the mean certainty: what no camera sees, motion along the only line of sight, stays small


def scene_flow(jacobian: Tensor, found: AnchorFlow) -> Tensor:
    """[n,3] world units that anchors went: least squares over the cameras, wrong flows doubted.

    Zero for anchors that no camera sees go anywhere.

    Args:
        jacobian: [C,n,2,3] as `projection_jacobians` has it.
    """
    weight, motion = found.seen, jacobian.new_zeros(jacobian.shape[1], 3)
    for _ in range(_ROUNDS):
        weighted = weight[..., None, None] * jacobian
        certainty = torch.einsum("cnij,cnik->njk", weighted, jacobian)
        pull = torch.einsum("cnij,cni->nj", weighted, found.flow)
        held = _STIFFNESS * certainty.diagonal(dim1=1, dim2=2).mean(dim=1) + 1e-12
        motion = torch.linalg.solve(certainty + torch.diag_embed(held[:, None].expand(-1, 3)), pull)
        weight = found.seen / (1 + (_distances(motion, jacobian, found) / _DOUBT) ** 2)
    return motion


def flow_error(motion: Tensor, jacobian: Tensor, found: AnchorFlow) -> Tensor:
    """[n] pixels by which `motion` [n,3] of anchors misses their flow, a mean over the cameras."""
    return (_distances(motion, jacobian, found) * found.seen).sum(dim=0) / found.seen.sum(dim=0).clamp_min(1e-6)


def projection_jacobians(position: Tensor, cameras: tuple[Camera, ...]) -> Tensor:
    """[C,n,2,3] pixels a world unit by which each camera sees places at `position` [n,3] move; no lens distortion."""
    parts = []
    for camera in cameras:
        pose, intrinsics = (torch.from_numpy(part).to(position) for part in (camera.world_to_camera, camera.intrinsics))
        x, y, depth = (position @ pose[:3, :3].T + pose[:3, 3]).unbind(dim=1)
        depth = depth.clamp_min(1e-6)
        in_camera = position.new_zeros(len(position), 2, 3)
        in_camera[:, 0, 0], in_camera[:, 0, 2] = 1 / depth, -x / depth**2
        in_camera[:, 1, 1], in_camera[:, 1, 2] = 1 / depth, -y / depth**2
        parts.append(intrinsics[:2, :2] @ in_camera @ pose[:3, :3])
    return torch.stack(parts)


def _distances(motion: Tensor, jacobian: Tensor, found: AnchorFlow) -> Tensor:
    """[C,n] pixels between the flow of anchors and what `motion` [n,3] would make it."""
    distances: Tensor = (torch.einsum("cnij,nj->cni", jacobian, motion) - found.flow).norm(dim=2)
    return distances
