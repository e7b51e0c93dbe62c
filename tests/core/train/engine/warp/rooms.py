"""A small frame in the memory of a step, and the same frame in float64 torch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.render import rasterise
from streamlod.core.train.engine.warp.frame import (
    add_anchors,
    begin,
    load_anchors,
    load_cameras,
    load_pictures,
    load_still,
)
from streamlod.core.train.engine.warp.room import Capacity, StepRoom, step_room, view_of
from streamlod.core.train.field.decode import Splats, join
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from tests.core.train.fields import random_field
from tests.core.train.references import (
    dead_zone_through,
    decode_reference,
    photometric_reference,
    residual_bits_reference,
)

SIZE = 96, 54
ANCHORS, SLOTS, FEATURES, ADDED = 24, 4, 8, 5
DSSIM, PRICE = 0.2, 3e-5
RATES = (0.1, 0.2)
ADDED_RATES = 0.1, 0.2, 0.3, 0.4
TOLD = (*RATES, 1 / (1 - 0.999), 0.4, 0.001, 0.0, PRICE, DSSIM, *ADDED_RATES, 1 / (1 - 0.999), 0)


@dataclass(frozen=True, eq=False)
class SmallFrame:
    """One later frame of three cameras.

    Attributes:
        trained, still: anchors; the latter are decoded for each camera.
        feature [12,F], offset [12,3K]: the latents' decoders. step: [n].
        latent: [n,24], position: [n,3] where training begins; the latter in pixels of `steps_a_pixel` [n].
        node: [m,3] of new anchors; values, width: [m,F+3K+9] their numbers in steps, and how wide these are.
    """

    cameras: tuple[Camera, ...]
    exposure: Exposure
    trained: Field
    still: Field
    feature: Tensor
    offset: Tensor
    step: Tensor
    steps_a_pixel: Tensor
    latent: Tensor
    position: Tensor
    node: Tensor
    values: Tensor
    width: Tensor
    targets: Tensor
    weights: Tensor

    def centre(self, camera: int) -> Tensor:
        return torch.from_numpy(self.cameras[camera].centre)

    def still_splats(self) -> list[Splats]:
        centres = [self.centre(number).float() for number in range(len(self.cameras))]
        return [self.still.decode(centre) for centre in centres[: 3 if self.still.view_dependent else 1]]

    def capacity(self, views: int, **changes: Any) -> Capacity:
        usual = Capacity(
            views=views,
            cameras=3,
            width=self.cameras[0].width,
            height=self.cameras[0].height,
            anchors=ANCHORS + 3,
            added=ADDED + 2,
            slots=SLOTS,
            features=FEATURES,
            still=len(self.still) * SLOTS + 5,
            moving_pairs=1 << 13,
            still_pairs=1 << 13,
            steps=40,
            sees_views=self.trained.view_dependent,
        )
        return replace(usual, **changes)

    def loaded(self, views: int, device: str = "cpu", **changes: Any) -> StepRoom:
        """In memory, every tile dirty."""
        room = step_room(self.capacity(views, **changes), device)
        self.load(room)
        return room

    def load(self, room: StepRoom) -> None:
        load_cameras(room, self.cameras, self.exposure)
        load_anchors(room, self.trained, self.feature, self.offset, self.step, self.steps_a_pixel)
        load_still(room, self.still_splats())
        load_pictures(room, self.targets, torch.zeros_like(self.targets), self.weights)
        view_of(room.sight.dirty).fill_(1)
        begin(room, self.latent, self.position)
        add_anchors(room, self.node, self.values, self.width)

    def splats(self, latent: Tensor, position: Tensor, values: Tensor, camera: int) -> Splats:
        """The trained Gaussians and the new ones in float64, before exposure."""
        field = self.trained
        moves = position * self.steps_a_pixel.double()[:, None]
        latent, steps = dead_zone_through(latent), dead_zone_through(moves)
        feature = field.feature.double() + latent[:, :12] @ self.feature.double()
        offset = field.offset.double() + (latent[:, 12:] @ self.offset.double()).view(field.offset.shape)
        position = field.position.double() + steps * self.step.double()[:, None]
        known = self._decoded(feature, offset, field.scaling.double(), position, camera)
        sent = (values + (values.round() - values).detach()) * self.width.double()
        feature, flat, scaling, place = torch.split(sent, [FEATURES, 3 * SLOTS, 6, 3], dim=1)
        new = self._decoded(feature, flat.reshape(-1, SLOTS, 3), scaling, self.node.double() + place, camera)
        return join(known, new)

    def _decoded(self, feature: Tensor, offset: Tensor, scaling: Tensor, position: Tensor, camera: int) -> Splats:
        if self.trained.view_dependent:
            away = position.detach() - self.centre(camera)
            distance = away.norm(dim=1, keepdim=True)
            feature = torch.cat([feature, away / distance, distance / self.trained.reference_distance], dim=1)
        network = (value.double() for value in self.trained.network.parameters())
        return Splats(*decode_reference(feature, offset, scaling, position, *network))

    def picture(self, splats: Splats, camera: int) -> Tensor:
        """[H,W,3] as the camera films it, in float64."""
        number = min(camera, len(self.still_splats()) - 1)
        still = Splats(*(part.double() for part in self.still_splats()[number].astuple()))
        gain, offset = self.exposure.gain[camera].double(), self.exposure.offset[camera].double()
        every = join(splats, still)
        every = replace(every, colours=every.colours * gain + offset)
        return rasterise(*every.astuple(), self.cameras[camera], offset, backend="reference").image

    def loss(self, latent: Tensor, position: Tensor, values: Tensor, cameras: tuple[int, ...]) -> Tensor:
        """What a step minimises, in float64."""
        found = PRICE * residual_bits_reference(latent, position * self.steps_a_pixel.double()[:, None])
        for camera in cameras:
            image = self.picture(self.splats(latent, position, values, camera), camera)
            weights = self.weights[camera][..., None].expand(-1, -1, 3).double()
            loss = photometric_reference(image, self.targets[camera].double(), DSSIM, None, weights)
            found = found + loss / len(cameras)
        return found

    def gradients(self, cameras: tuple[int, ...]) -> tuple[float, Tensor, Tensor]:
        """The loss, and its gradient by latents and positions [n,27] and by new anchors' numbers [m,F+3K+9]."""
        leaves = [part.double().requires_grad_() for part in (self.latent, self.position, self.values)]
        loss = self.loss(*leaves, cameras)
        latent, position, values = torch.autograd.grad(loss, leaves)
        return float(loss.detach()), torch.cat([latent, position], dim=1), values


def small_frame(*, view_dependent: bool = False, seed: int = 0, size: tuple[int, int] = SIZE) -> SmallFrame:
    """Anchors about the origin; some move, others stand still."""
    g = torch.Generator().manual_seed(seed)
    field = random_field(60, SLOTS, view_dependent=view_dependent, seed=seed)
    trained, still = (field.with_rows(rows) for rows in torch.arange(60).split([ANCHORS, 36]))
    cameras = tuple(_camera(angle, size) for angle in (-0.5, 0.1, 0.6))
    return SmallFrame(
        cameras=cameras,
        exposure=Exposure(1 + 0.1 * torch.randn(3, 3, generator=g), 0.02 * torch.randn(3, 3, generator=g)),
        trained=trained,
        still=still,
        feature=0.2 * torch.randn(12, FEATURES, generator=g),
        offset=0.1 * torch.randn(12, 3 * SLOTS, generator=g),
        step=0.01 + 0.01 * torch.rand(ANCHORS, generator=g),
        steps_a_pixel=0.6 + torch.rand(ANCHORS, generator=g),
        latent=2 * torch.randn(ANCHORS, 24, generator=g) * (torch.rand(ANCHORS, 24, generator=g) < 0.4),
        position=3 * torch.randn(ANCHORS, 3, generator=g),
        **_new(g),
        targets=torch.rand(3, *size[::-1], 3, generator=g),
        weights=1 + torch.rand(3, *size[::-1], generator=g),
    )


def _new(g: torch.Generator) -> dict[str, Tensor]:
    """Anchors that are added, about as large as the others."""
    numbers = FEATURES + 3 * SLOTS + 6 + 3
    sizes = torch.cat([torch.zeros(FEATURES + 3 * SLOTS), torch.full((6,), -30.0), torch.zeros(3)])
    width = torch.cat([torch.full((FEATURES + 3 * SLOTS + 6,), 0.1), torch.full((3,), 0.02)])
    return {
        "node": torch.rand(ADDED, 3, generator=g) - 0.5,
        "values": sizes + 6 * torch.randn(ADDED, numbers, generator=g),
        "width": width.expand(ADDED, numbers).clone(),
    }


def _camera(angle: float, size: tuple[int, int]) -> Camera:
    eye = 3.2 * np.array([np.sin(angle), -0.2, -np.cos(angle)])
    pose = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return pinhole(f"at {angle}", (80.0, 82.0), (0.49 * size[0], 0.52 * size[1]), size, pose)


def relative(found: Tensor, wanted: Tensor) -> float:
    """|found - wanted| / |wanted|."""
    return float((found.double() - wanted).norm() / wanted.norm())
