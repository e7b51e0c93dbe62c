"""A frame's anchors, still Gaussians and pictures, written into the memory of a step."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.errors import ModelError
from streamlod.core.render.warp.listing import camera_rows, list_gaussians
from streamlod.core.scene.anchors import FEATURE_LATENTS, HIDDEN
from streamlod.core.scene.gaussians import MAX_LOG_SCALE
from streamlod.core.train.engine.warp.room import StepRoom, view_of
from streamlod.core.train.field.decode import Network, Splats
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.loss.photometric import blurred_moments


def load_anchors(
    room: StepRoom, base: Field, feature: Tensor, offset: Tensor, step: Tensor, steps_a_pixel: Tensor
) -> None:
    """The anchors in training, as they were before the frame.

    Args:
        base: n anchors. feature [12,F], offset [12,3K]: the latents' decoders. step: [n] world units of a position's.
        steps_a_pixel: [n]; positions are trained in pixels.

    Raises:
        ModelError: more anchors than there is room for.
    """
    count, capacity = len(base), room.capacity
    if count > capacity.anchors:
        raise ModelError(f"{count} anchors are to be trained, and there is room for {capacity.anchors}")
    network, features = base.network, base.feature.shape[1]
    hidden = network.hidden_weight[:features]
    _fill(room.base.hidden, torch.addmm(network.hidden_bias, base.feature, hidden))
    _fill(room.base.offset, base.offset)
    size = base.scaling.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE).exp()
    _fill(room.base.offset_size, size[:, :3])
    _fill(room.base.scale_size, size[:, 3:])
    _fill(room.base.node, base.position)
    _fill(room.base.step, step)
    _fill(room.base.steps_a_pixel, steps_a_pixel)
    view_of(room.base.count)[0] = count
    _fill(room.added.weight, hidden)
    _fill(room.added.bias, network.hidden_bias)
    load_network(room, network, feature, offset, features)
    view_of(room.decoders.distance)[0] = base.reference_distance if base.view_dependent else 0.0


def load_network(room: StepRoom, network: Network, feature: Tensor, offset: Tensor, features: int) -> None:
    """The shared network with the latents' decoders folded in."""
    slots, weight = room.capacity.slots, network.hidden_weight
    _fill(room.decoders.latent, (feature @ weight[:features]).T)
    view = torch.zeros(HIDDEN, 4, device=weight.device)
    view[:, : len(weight) - features] = weight[features:].T
    _fill(room.decoders.view, view)
    _fill(room.decoders.offset, offset.view(FEATURE_LATENTS, slots, 3))
    outputs = torch.cat([network.output_weight, network.output_bias[None]])
    opacity, colour, scale, rotation = torch.split(outputs, [slots, 3 * slots, 3 * slots, 4 * slots], dim=1)
    _fill(room.decoders.opacity, opacity)
    for array, part in (
        (room.decoders.colour, colour),
        (room.decoders.scale, scale),
        (room.decoders.rotation, rotation),
    ):
        _fill(array, part.reshape(HIDDEN + 1, slots, -1))


def load_still(room: StepRoom, splats: Sequence[Splats]) -> None:
    """Project and list the Gaussians that stand still: of each camera, or one set for all.

    `room.still.overflow` tells by how many pairs of Gaussian and tile there are more than there is room for.

    Raises:
        ModelError: more Gaussians than there is room for.
    """
    most = max(map(len, splats))
    if most > room.capacity.still:
        raise ModelError(f"{most} Gaussians stand still, and there is room for {room.capacity.still}")
    for name in ("means", "quaternions", "scales", "opacities", "colours"):
        view = view_of(getattr(room.still_cloud, name))
        for number, own in enumerate(splats[: len(view)]):
            values = getattr(own, name)
            view[number, : len(values)].copy_(values)
            view[number, len(values) :] = 0  # an opacity of 0 is not drawn
    view_of(room.still_count)[0] = most
    sight, clean = room.sight, wp.zeros_like(room.sight.dirty)
    every = wp.array(list(range(room.capacity.cameras)), dtype=int, device=room.device)
    cameras = (every, sight.cameras, sight.grid, clean)
    list_gaussians(room.still, room.still_count, room.still_cloud, *cameras, room.device)


def load_cameras(room: StepRoom, cameras: Sequence[Camera], exposure: Exposure) -> None:
    """The rig; what lies behind everything is black, as the cameras expose it."""
    gain, offset = (value.detach().cpu().numpy() for value in (exposure.gain, exposure.offset))
    _fill(room.sight.cameras, torch.from_numpy(camera_rows(cameras, gain, offset, offset)))
    _fill(room.as_filmed, torch.from_numpy(camera_rows(cameras, behind=offset)))
    centres = [torch.from_numpy(camera.centre).float() for camera in cameras]
    _fill(room.decoders.centre, torch.stack(centres))


def load_pictures(room: StepRoom, targets: Tensor, shown: Tensor, weights: Tensor | None) -> None:
    """What the cameras filmed [C,H,W,3], what the state before shows them [C,H,W,3], and weights of errors [C,H,W].

    All tiles become clean; cameras without a picture hold NaN, and no step may choose them.
    """
    load_targets(room, targets)
    view_of(room.filmed.weight).copy_(torch.ones_like(targets[..., 0]) if weights is None else weights)
    _fill(room.sight.base, shown)
    room.sight.dirty.zero_()


def load_targets(room: StepRoom, targets: Tensor) -> None:
    """Pictures [C,H,W,3] that the cameras should show."""
    _fill(room.filmed.target, targets)
    mean, square = blurred_moments(targets)
    _fill(room.filmed.mean, mean)
    _fill(room.filmed.square, square)


def begin(room: StepRoom, latent: Tensor, position: Tensor) -> None:
    """Let training begin at `latent` [n,24] and `position` [n,3] pixels, without moments, nothing added."""
    t = room.trained
    for array in (t.values, t.gradient, t.first, t.second, t.mean, t.totals, t.broken, room.added.count):
        array.zero_()
    numbers = view_of(t.values).view(-1, 27)
    numbers[: len(latent)] = torch.cat([latent, position], dim=1)


def add_anchors(room: StepRoom, node: Tensor, values: Tensor, width: Tensor) -> None:
    """Let m new anchors be trained from now on.

    Args:
        node: [m,3] world positions of their grid nodes. values: [m,F+3K+9] their numbers, in steps of `width`, alike.

    Raises:
        ModelError: more than there is room for.
    """
    count, capacity = len(node), room.capacity
    if count > capacity.added:
        raise ModelError(f"{count} anchors are to be added, and there is room for {capacity.added}")
    own = room.trained_added
    for array in (own.first, own.second, own.mean):
        array.zero_()
    _fill(own.values, values)
    _fill(room.added.node, node)
    _fill(room.added.width, width)
    view_of(room.added.count)[0] = count


def _fill(array: object, values: Tensor) -> None:
    """Write `values` over the first rows of a Warp array."""
    view = view_of(array)
    view[: len(values)].copy_(values.detach().reshape(len(values), *view.shape[1:]))
