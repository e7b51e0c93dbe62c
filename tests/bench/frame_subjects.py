"""What the benchmark of whole frames trains: a scene of known size, a small rig, and a compact part that moves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from core.anchors import Scene
from core.camera import Camera, pinhole
from core.frames import FrameSet
from core.octree import Octree
from core.render import Backend, rasterise
from core.train.config import PredictConfig
from core.train.convert import field_of, scene_of
from core.train.decode import Network
from core.train.field import Field

SLOTS, FEATURES, HIDDEN = 10, 16, 32
_CELL = 0.02  # world units
_FOCUS = np.array([0.0, 0.0, 5.0])  # what moves lies about this point
_SHIFT = np.array([0.04, 0.02, 0.0], np.float32)  # and moves so far in a frame: about 4 pixels


@dataclass(frozen=True, slots=True, eq=False)
class FrameCase:
    """A state, and pictures of it: as it is shown, and with its moving part moved."""

    cameras: tuple[Camera, ...]
    scene: Scene
    before: FrameSet
    after: FrameSet


def make_case(anchors: int, views: int, size: tuple[int, int], share: float, backend: Backend = "cpu") -> FrameCase:
    """`anchors` of ten Gaussians each, filling the view; the `share` of them nearest to one point moves."""
    cameras = _rig(views, *size)
    field = _field(anchors, size[0])
    scene = scene_of(field, PredictConfig(), cameras, 30.0, 0)
    field = field_of(scene)
    order = np.argsort(np.linalg.norm(field.position.numpy() - _FOCUS, axis=1))
    moving = torch.from_numpy(order[: round(share * anchors)])
    position = field.position.clone()
    position[moving] += torch.from_numpy(_SHIFT)
    moved = replace(field, position=position)
    return FrameCase(cameras, scene, _filmed(field, cameras, 0, backend), _filmed(moved, cameras, 1, backend))


def _rig(views: int, width: int, height: int) -> tuple[Camera, ...]:
    focal, cameras = 0.5 * width / math.tan(math.radians(30)), []
    for i in range(views):
        pose = np.eye(4)
        pose[:3, 3] = 0.15 * (i - (views - 1) / 2), 0.05 * (-1) ** i, 0.0
        cameras.append(pinhole(f"cam{i:02d}", (focal, focal), (width / 2, height / 2), (width, height), pose))
    return tuple(cameras)


def _field(anchors: int, width: int) -> Field:
    """Depth log-uniform in 2 to 12 and Gaussians of about 6 pixels' radius (3 sigma) at 640 pixels' width, as in
    `raster_subjects.make_scene`; ten about each anchor, on different sides of it."""
    g, t = np.random.default_rng(0), torch.Generator().manual_seed(0)
    octree = Octree(np.array([-12.0, -12.0, 0.0]), _CELL, 1)
    z = np.exp(g.uniform(np.log(2), np.log(12), 2 * anchors))
    slope = math.tan(math.radians(30)) * 1.05
    points = np.stack([g.uniform(-slope, slope, len(z)) * z, g.uniform(-slope, slope, len(z)) * 0.75 * z, z], 1)
    voxel = np.unique(octree.voxel_of(points, 0), axis=0)
    voxel = voxel[g.permutation(len(voxel))[:anchors]]
    position = octree.node_of(voxel, 0)
    pixel = torch.from_numpy(position[:, 2]).float() * 2 * math.tan(math.radians(30)) / 640
    scaling = torch.log(torch.cat([pixel[:, None].expand(-1, 3) * 8, pixel[:, None].expand(-1, 3) * 3], 1))
    weight = torch.randn(HIDDEN, 11 * SLOTS, generator=t) / math.sqrt(HIDDEN)
    bias = torch.zeros(11 * SLOTS)
    bias[:SLOTS] = 0.6
    weight[:, :SLOTS] *= 0.4
    return Field(
        octree=octree,
        reference_distance=6.0,
        view_dependent=False,
        level=torch.zeros(len(voxel), dtype=torch.int64),
        voxel=torch.from_numpy(voxel),
        extra_level=torch.zeros(len(voxel)),
        position=torch.from_numpy(position).float(),
        feature=torch.randn(len(voxel), FEATURES, generator=t),
        offset=torch.randn(len(voxel), SLOTS, 3, generator=t),
        scaling=scaling,
        network=Network(torch.randn(FEATURES, HIDDEN, generator=t) / 4, torch.zeros(HIDDEN), weight, bias),
    )


def _filmed(field: Field, cameras: tuple[Camera, ...], index: int, backend: Backend) -> FrameSet:
    device = "cuda" if backend == "cuda" else "cpu"
    there, background = field.to(device), torch.zeros(3, device=device)
    pictures = []
    with torch.no_grad():
        for camera in cameras:
            splats = there.decode(torch.from_numpy(camera.centre).float().to(device))
            image = rasterise(*splats.astuple(), camera=camera, background=background, backend=backend).image
            pictures.append((image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy())
    return FrameSet(index, index * 33_000_000, np.stack(pictures), np.ones(len(cameras), np.bool_))
