"""What the benchmark of whole frames trains: a scene of known size, a small rig, and a compact part that moves."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import torch

from streamlod.codec.encoder import encode_residual
from streamlod.core.camera import Camera, pinhole
from streamlod.core.data import linspace_split
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.render import Backend, rasterise, select
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.octree import Octree
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, TrainConfig, TrainedFrame, Trainer, preset
from streamlod.core.train.field.convert import field_of, scene_of
from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.field import Field, visible_levels
from tests.bench.raster_subjects import convolution_loss

SLOTS, FEATURES, HIDDEN = 10, 16, 32
_CELL = 0.02  # world units
_SHIFT = np.array([0.04, 0.02, 0.0], np.float32)  # and moves so far in a frame: about 4 pixels


@dataclass(frozen=True, slots=True, eq=False)
class FrameCase:
    """A state, and pictures of it: as it is shown, and with its moving part moved."""

    cameras: tuple[Camera, ...]
    scene: Scene
    before: FrameSet
    after: FrameSet


def make_case(
    anchors: int, views: int, size: tuple[int, int], share: float, backend: Backend = "cpu", depth: float = 5.0
) -> FrameCase:
    """`anchors` of ten Gaussians each, filling the view; the `share` of them nearest to a point `depth` away moves."""
    cameras, scene = make_state(anchors, views, size)
    field = field_of(scene)
    order = np.argsort(np.linalg.norm(field.position.numpy() - [0, 0, depth], axis=1))
    moving = torch.from_numpy(order[: round(share * anchors)])
    position = field.position.clone()
    position[moving] += torch.from_numpy(_SHIFT)
    moved = replace(field, position=position)
    return FrameCase(cameras, scene, _filmed(field, cameras, 0, backend), _filmed(moved, cameras, 1, backend))


def make_state(anchors: int, views: int, size: tuple[int, int]) -> tuple[tuple[Camera, ...], Scene]:
    """The cameras and the state of such a case."""
    cameras = _rig(views, *size)
    return cameras, scene_of(_field(anchors, size[0]), PredictConfig(), cameras, 30.0, 0)


class Streaming:
    """Our frame, from the state before to the packet."""

    def __init__(self, case: FrameCase, config: TrainConfig, device: str = "cpu") -> None:
        self._case = case
        self._trainer = Trainer(case.cameras, config, 30.0, device)
        self._device = device
        self.result: TrainedFrame | None = None
        self.packet, self.encode_seconds = b"", 0.0
        self.reset()

    def reset(self) -> None:
        """Back to the state before, shown its own pictures."""
        self._trainer.resume(self._case.scene)
        self._trainer.predict(self._case.before)

    def run(self) -> None:
        """One frame."""
        before, frames = self._trainer.scene, self._case.after
        self.result = self._trainer.predict(frames)
        assert self.result.residual is not None
        begin = time.perf_counter()
        self.packet = encode_residual(before, self.result.residual, time_ns=frames.time_ns)
        self.encode_seconds = time.perf_counter() - begin

    def draw(self, pictures: int) -> None:
        """Decode and draw the state: every picture chooses its levels by distance, as a viewer does."""
        draw_pictures(field_of(self._trainer.scene).to(self._device), self._case.cameras, self._device, pictures)


def draw_pictures(field: Field, cameras: tuple[Camera, ...], device: str, pictures: int) -> None:
    """Draw `field`, which is on `device`: levels chosen by distance and anchors decoded for every picture anew."""
    background, backend = torch.zeros(3, device=device), select(device)
    with torch.no_grad():
        for i in range(pictures):
            camera = cameras[i % len(cameras)]
            centre = torch.from_numpy(camera.centre).float().to(device)
            rows = torch.nonzero(visible_levels(field, centre, field.octree.levels - 1))[:, 0]
            splats = field.decode(centre, rows)
            rasterise(*splats.astuple(), camera=camera, background=background, backend=backend)
    if device == "cuda":
        torch.cuda.synchronize()


class Naive:
    """Training steps over the whole model."""

    def __init__(self, case: FrameCase) -> None:
        self._cameras = case.cameras
        self._targets = torch.from_numpy(case.after.images).float() / 255
        field = field_of(case.scene)
        names = ("feature", "offset", "scaling", "position")
        self._leaves = {name: getattr(field, name).clone().requires_grad_() for name in names}
        weights = [value.clone().requires_grad_() for value in field.network.parameters()]
        self._field = replace(field, **self._leaves, network=Network(*weights))
        self._optimiser = torch.optim.Adam([*self._leaves.values(), *weights], lr=1e-4)

    def step(self, view: int) -> None:
        """One view, one update."""
        camera = self._cameras[view]
        splats = self._field.decode(torch.from_numpy(camera.centre).float())
        image = rasterise(*splats.astuple(), camera=camera, background=torch.zeros(3)).image
        convolution_loss(image, self._targets[view]).backward()
        self._optimiser.step()
        self._optimiser.zero_grad()

    def run(self, epochs: int) -> None:
        """As many steps as a streaming frame has."""
        for _ in range(epochs):
            for view in range(len(self._cameras)):
                self.step(view)


def trained_clip(
    size: tuple[int, int], views: int, anchors: int, epochs: int, frames: int
) -> tuple[Trainer, list[FrameSet]]:
    """A trainer that has learnt the first frame of the synthetic clip, and all its frames."""
    made = open_synthetic(SyntheticSpec(frames=frames, width=size[0], height=size[1]))
    rows = [made.names.index(name) for name in linspace_split(made.names, views, ("cam00",)).train]
    cameras, live = tuple(made.cameras[row] for row in rows), preset("live")
    config = replace(
        live,
        model=replace(live.model, max_anchors=anchors),
        predict=replace(live.predict, epochs=epochs, minimum_steps=0, most_effort=1.0),
    )
    filmed = [FrameSet(f.index, f.time_ns, f.images[rows], f.present[rows]) for f in made.frames()]
    trainer = Trainer(cameras, config, made.fps, "cpu")
    trainer.keyframe(filmed[0], first_points(filmed[0], cameras, depth_bounds=made.depth_bounds))
    return trainer, filmed


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
