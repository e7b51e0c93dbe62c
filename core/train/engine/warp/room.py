"""Memory of a training step: taken once, filled anew for every frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import warp as wp

from streamlod.core.render.warp.kernels.rules import CAMERA_NUMBERS
from streamlod.core.render.warp.listing import TileLists, cloud_room, grid_of, listing
from streamlod.core.render.warp.pictures import DrawnViews, Sight, pictures
from streamlod.core.scene.anchors import HIDDEN, LATENTS, OFFSET_LATENTS, SCALINGS
from streamlod.core.scene.entropy_model import magnitude_bits
from streamlod.core.train.engine.warp.kernels.added import PULLS, Added
from streamlod.core.train.engine.warp.kernels.layout import TOLD, TOTALS, AnchorBase, Decoders, vec12
from streamlod.core.train.engine.warp.kernels.loss import Filmed, Planes
from streamlod.core.train.loss.photometric import SIGMA, WINDOW

_LARGEST_MAGNITUDE = 64  # of the table of bits


@dataclass(frozen=True, slots=True)
class Capacity:
    """What a step has room for.

    Attributes:
        views: pictures of a step. cameras: of the rig. width, height: of every picture, in pixels.
        anchors: in training. added: anchors that a frame may add, at least 1. slots: Gaussians of each.
        features: F of an anchor. still: Gaussians that stand still.
        moving_pairs, still_pairs: of a Gaussian and a tile, of all views, cameras.
        steps: of a frame. sees_views: whether the network sees the view.
    """

    views: int
    cameras: int
    width: int
    height: int
    anchors: int
    added: int
    slots: int
    features: int
    still: int
    moving_pairs: int
    still_pairs: int
    steps: int
    sees_views: bool

    @property
    def numbers(self) -> int:
        """Numbers of anchors that there are already."""
        return self.anchors * (LATENTS + 3)

    @property
    def numbers_added(self) -> int:
        """Numbers of each anchor that is added (`kernels.added`)."""
        return self.features + 3 * self.slots + SCALINGS + 3

    @property
    def gaussians(self) -> int:
        """Those in training, with those that are added."""
        return (self.anchors + self.added) * self.slots


@dataclass(frozen=True, slots=True, eq=False)
class Trained:
    """Flat arrays of every number that is trained (`kernels.layout`), and what a step leaves beside them.

    Attributes:
        values, gradient, first, second, mean: [numbers] float32.
        steps, rows, pulls, totals: see `kernels.decode` and `kernels.rate`.
        losses: [steps] of a frame. broken: [1] entries of gradients that were not finite.
    """

    values: Any
    gradient: Any
    first: Any
    second: Any
    mean: Any
    steps: Any
    rows: Any
    pulls: Any
    totals: Any
    losses: Any
    broken: Any


@dataclass(frozen=True, slots=True, eq=False)
class TrainedAdded:
    """Numbers of the anchors that a frame adds.

    Attributes:
        values, first, second, mean: [M,F+3K+9] float32. pulls: [K,M,44], see `kernels.added`.
    """

    values: Any
    first: Any
    second: Any
    mean: Any
    pulls: Any


@dataclass(frozen=True, slots=True, eq=False)
class StepRoom:
    """All arrays of a step, by what they are for; `as_filmed` are the cameras for colours that are exposed already."""

    capacity: Capacity
    device: str
    base: Any
    added: Any
    decoders: Any
    trained: Trained
    trained_added: TrainedAdded
    as_filmed: Any
    cloud: Any
    by_cloud: Any
    still_cloud: Any
    still_count: Any
    moving_count: Any
    moving: TileLists
    still: TileLists
    sight: Sight
    drawn: DrawnViews
    filmed: Any
    lines: Any
    slopes: Any
    told: Any
    window: Any
    table: Any


def step_room(capacity: Capacity, device: str) -> StepRoom:
    """Take the memory."""
    c, grid = capacity, grid_of(capacity.width, capacity.height)
    own = c.views if c.sees_views else 1
    window = np.exp(-((np.arange(WINDOW) - WINDOW // 2) ** 2) / (2 * SIGMA**2))

    def zeros(shape: int | tuple[int, ...], dtype: Any = float) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device)

    sight = Sight(
        grid,
        zeros((c.cameras, CAMERA_NUMBERS)),
        zeros(c.views, int),
        zeros((c.cameras, grid.tiles), int),
        zeros((c.cameras, c.height, c.width), wp.vec3),
    )
    return StepRoom(
        capacity=c,
        device=device,
        base=_anchor_base(c, zeros),
        added=_added(c, zeros),
        decoders=_decoders(c, zeros),
        trained=_trained(c, zeros),
        trained_added=_trained_added(c, zeros),
        as_filmed=zeros((c.cameras, CAMERA_NUMBERS)),
        cloud=cloud_room(own, c.gaussians, device),
        by_cloud=cloud_room(own, c.gaussians, device),
        still_cloud=cloud_room(c.cameras if c.sees_views else 1, c.still, device),
        still_count=zeros(1, int),
        moving_count=zeros(1, int),
        moving=listing(c.views, c.gaussians, c.moving_pairs, grid, device),
        still=listing(c.cameras, c.still, c.still_pairs, grid, device),
        sight=sight,
        drawn=pictures(c.views, c.gaussians, grid, device),
        filmed=_filmed(c, zeros),
        lines=_planes(c, zeros),
        slopes=_planes(c, zeros),
        told=zeros(TOLD),
        window=wp.array((window / window.sum()).astype(np.float32), dtype=float, device=device),
        table=wp.array(magnitude_bits(_LARGEST_MAGNITUDE), dtype=float, device=device),
    )


def room_beside(room: StepRoom, width: int, height: int, moving_pairs: int, still_pairs: int) -> StepRoom:
    """Memory for steps on pictures of another size that train the same numbers as those in `room`."""
    capacity = replace(room.capacity, width=width, height=height, moving_pairs=moving_pairs, still_pairs=still_pairs)
    own = step_room(capacity, room.device)
    shared = ("base", "added", "decoders", "trained", "trained_added", "cloud", "by_cloud", "still_cloud")
    counts = ("still_count", "moving_count")
    return replace(own, **{name: getattr(room, name) for name in (*shared, *counts)})


def view_of(array: Any) -> torch.Tensor:
    """A Warp array as a tensor of the same memory."""
    return torch.as_tensor(wp.to_torch(array))


def _anchor_base(c: Capacity, zeros: Any) -> Any:
    base = AnchorBase()
    base.count = zeros(1, int)
    base.hidden, base.offset = zeros((c.anchors, HIDDEN)), zeros((c.anchors, c.slots), wp.vec3)
    base.offset_size, base.scale_size = zeros(c.anchors, wp.vec3), zeros(c.anchors, wp.vec3)
    base.node = zeros(c.anchors, wp.vec3)
    base.step, base.steps_a_pixel = zeros(c.anchors), zeros(c.anchors)
    return base


def _added(c: Capacity, zeros: Any) -> Any:
    added = Added()
    added.count, added.node = zeros(1, int), zeros(c.added, wp.vec3)
    added.width = zeros((c.added, c.numbers_added))
    added.weight, added.bias = zeros((c.features, HIDDEN)), zeros(HIDDEN)
    return added


def _trained_added(c: Capacity, zeros: Any) -> TrainedAdded:
    values, first, second, mean = (zeros((c.added, c.numbers_added)) for _ in range(4))
    return TrainedAdded(values, first, second, mean, zeros((c.slots, c.added, PULLS)))


def _decoders(c: Capacity, zeros: Any) -> Any:
    decoders, rows = Decoders(), (HIDDEN + 1, c.slots)
    decoders.latent, decoders.view = zeros(HIDDEN, vec12), zeros(HIDDEN, wp.vec4)
    decoders.offset = zeros((OFFSET_LATENTS, c.slots), wp.vec3)
    decoders.opacity, decoders.colour = zeros(rows), zeros(rows, wp.vec3)
    decoders.scale, decoders.rotation = zeros(rows, wp.vec3), zeros(rows, wp.vec4)
    decoders.centre, decoders.distance = zeros(c.cameras, wp.vec3), zeros(1)
    return decoders


def _trained(c: Capacity, zeros: Any) -> Trained:
    values, gradient, first, second, mean = (zeros(c.numbers) for _ in range(5))
    steps, rows = zeros(c.anchors, wp.vec3), zeros(c.anchors, wp.vec2)
    pulls = zeros((c.slots, c.anchors, LATENTS + 3))
    last = zeros(TOTALS), zeros(c.steps), zeros(1, int)
    return Trained(values, gradient, first, second, mean, steps, rows, pulls, *last)


def _planes(c: Capacity, zeros: Any) -> Any:
    planes, shape = Planes(), (c.views, c.height, c.width)
    planes.one, planes.two, planes.three = (zeros(shape, wp.vec3) for _ in range(3))
    return planes


def _filmed(c: Capacity, zeros: Any) -> Any:
    filmed, shape = Filmed(), (c.cameras, c.height, c.width)
    filmed.target, filmed.mean, filmed.square = (zeros(shape, wp.vec3) for _ in range(3))
    filmed.weight = zeros(shape)
    return filmed
