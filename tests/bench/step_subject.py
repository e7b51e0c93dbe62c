"""A later frame of ordinary size in the memory of a training step: a box of anchors, of which those of a ball move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.scene.anchors import HIDDEN, OUTPUTS, SCALINGS
from streamlod.core.scene.octree import Octree
from streamlod.core.train.engine.warp.frame import begin, load_anchors, load_cameras, load_pictures, load_still
from streamlod.core.train.engine.warp.frame_steps import StepSettings
from streamlod.core.train.engine.warp.frame_steps import told as told_step
from streamlod.core.train.engine.warp.room import Capacity, StepRoom, step_room, view_of
from streamlod.core.train.engine.warp.step import TrainingStep
from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.exposure import neutral
from streamlod.core.train.field.field import Field

FEATURES = 32
MEMORY, RATES, PRICE, DSSIM = 0.6, (0.3, 0.7), 0.007, 0.2  # of the preset live


@dataclass(frozen=True)
class Sizes:
    """anchors of which `moving` are trained, Gaussians an anchor, pictures, cameras, and views of a step."""

    anchors: int = 25_000
    moving: int = 2_500
    slots: int = 10
    width: int = 1280
    height: int = 720
    cameras: int = 5
    views: int = 1


def told(number: int, pixels: int) -> tuple[float, ...]:
    """What step `number` from 0 is told, on pictures of so many pixels."""
    return told_step(number, StepSettings(*RATES, MEMORY, PRICE / (3 * pixels), DSSIM))


def make_step(sizes: Sizes, device: str, seed: int = 0) -> TrainingStep:
    """A step whose room holds a frame; no tile is dirty but those that what moves reaches."""
    g = torch.Generator().manual_seed(seed)
    field = _field(sizes, g)
    order = field.position.norm(dim=1).argsort()
    moving, still = (
        field.with_rows(rows).to(device) for rows in order.split([sizes.moving, len(order) - sizes.moving])
    )
    cameras = tuple(_camera(angle, sizes) for angle in np.linspace(-0.6, 0.6, sizes.cameras))
    room = step_room(_capacity(sizes), device)
    load_cameras(room, cameras, neutral(sizes.cameras, device))
    feature, offset = 0.3 * torch.randn(12, FEATURES, generator=g), 0.1 * torch.randn(12, 3 * sizes.slots, generator=g)
    step = torch.full((sizes.moving,), 0.002, device=device)
    load_anchors(room, moving, feature.to(device), offset.to(device), step, torch.full_like(step, 2.0))
    load_still(room, [still.decode(torch.zeros(3, device=device))])
    shape = (sizes.cameras, sizes.height, sizes.width, 3)
    smooth = torch.rand(sizes.cameras, 3, 9, 16, generator=g)
    targets = torch.nn.functional.interpolate(smooth, shape[1:3], mode="bilinear").permute(0, 2, 3, 1).to(device)
    load_pictures(room, targets, targets, None)
    begin(room, torch.zeros(sizes.moving, 24, device=device), torch.zeros(sizes.moving, 3, device=device))
    return TrainingStep(room)


def work(room: StepRoom) -> dict[str, int]:
    """Sizes of what the last step did."""
    sight, capacity = room.sight, room.capacity
    dirty = view_of(sight.dirty)[view_of(sight.chosen).long()] > 0
    spans = view_of(room.still.layer.last) - view_of(room.still.layer.first)
    reached = spans.view(capacity.cameras, -1)[view_of(sight.chosen).long()][dirty]
    return {
        "tiles": dirty.numel(),
        "dirty tiles": int(dirty.sum()),
        "moving Gaussians": int(view_of(room.moving_count)[0]),
        "room for pairs of moving": capacity.moving_pairs,
        "pairs of moving": int(view_of(room.moving.wanted)[0]),
        "pairs of still in dirty tiles": int(reached.sum()),
    }


def _capacity(sizes: Sizes) -> Capacity:
    gaussians = sizes.anchors * sizes.slots
    return Capacity(
        views=sizes.views,
        cameras=sizes.cameras,
        width=sizes.width,
        height=sizes.height,
        anchors=sizes.moving,
        added=sizes.anchors // 50,
        slots=sizes.slots,
        features=FEATURES,
        still=gaussians,
        moving_pairs=sizes.views * sizes.moving * sizes.slots * 8,
        still_pairs=sizes.cameras * gaussians * 4,
        steps=200,
        sees_views=False,
    )


def _field(sizes: Sizes, g: torch.Generator) -> Field:
    count, k = sizes.anchors, sizes.slots
    bias = torch.cat([torch.full((k,), 0.4), torch.zeros((OUTPUTS - 1) * k)])
    network = Network(
        torch.randn(FEATURES, HIDDEN, generator=g) / FEATURES**0.5,
        torch.zeros(HIDDEN),
        torch.randn(HIDDEN, OUTPUTS * k, generator=g) / HIDDEN**0.5,
        bias,
    )
    return Field(
        octree=Octree(origin=np.full(3, -1.0), root_cell=0.25, levels=4),
        reference_distance=4.0,
        view_dependent=False,
        level=torch.zeros(count, dtype=torch.int64),
        voxel=torch.zeros(count, 3, dtype=torch.int32),
        extra_level=torch.zeros(count),
        position=(2 * torch.rand(count, 3, generator=g) - 1) * torch.tensor([1.6, 0.9, 1.0]),
        feature=torch.randn(count, FEATURES, generator=g),
        offset=torch.randn(count, k, 3, generator=g),
        scaling=torch.full((count, SCALINGS), np.log(0.02)) + 0.4 * torch.randn(count, SCALINGS, generator=g),
        network=network,
    )


def _camera(angle: float, sizes: Sizes) -> Camera:
    eye = 3.5 * np.array([np.sin(angle), -0.1, -np.cos(angle)])
    focal = 1.0 * sizes.width
    size, middle = (sizes.width, sizes.height), (sizes.width / 2, sizes.height / 2)
    pose = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return pinhole(f"at {angle:.2f}", (focal, focal), middle, size, pose)
