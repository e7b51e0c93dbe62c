"""A small frame in the memory of a step, and the same frame in float64 torch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from streamlod.core.camera import Camera, look_at, pinhole
from streamlod.core.render import rasterise
from streamlod.core.train.engine.warp.frame import begin, load_anchors, load_cameras, load_pictures, load_still
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
ANCHORS, SLOTS = 24, 4
DSSIM, PRICE = 0.2, 3e-5
RATES = (0.1, 0.2)
TOLD = (*RATES, 1 / (1 - 0.999), 0.4, 0.001, 0.0, PRICE, DSSIM, 0)


@dataclass(frozen=True, eq=False)
class SmallFrame:
    """One later frame of three cameras.

    Attributes:
        trained, still: anchors; the latter are decoded for each camera.
        feature [12,F], offset [12,3K]: the latents' decoders. step: [n].
        latent: [n,24], position: [n,3] where training begins.
    """

    cameras: tuple[Camera, ...]
    exposure: Exposure
    trained: Field
    still: Field
    feature: Tensor
    offset: Tensor
    step: Tensor
    latent: Tensor
    position: Tensor
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
            slots=SLOTS,
            still=len(self.still) * SLOTS + 5,
            moving_pairs=1 << 13,
            still_pairs=1 << 13,
            steps=40,
            sees_views=self.trained.view_dependent,
        )
        return replace(usual, **changes)

    def loaded(self, views: int, **changes: Any) -> StepRoom:
        """In memory, every tile dirty."""
        room = step_room(self.capacity(views, **changes), "cpu")
        self.load(room)
        return room

    def load(self, room: StepRoom) -> None:
        load_cameras(room, self.cameras, self.exposure)
        load_anchors(room, self.trained, self.feature, self.offset, self.step)
        load_still(room, self.still_splats())
        load_pictures(room, self.targets, torch.zeros_like(self.targets), self.weights)
        view_of(room.sight.dirty).fill_(1)
        begin(room, self.latent, self.position)

    def splats(self, latent: Tensor, moves: Tensor, camera: int) -> Splats:
        """The trained Gaussians in float64, before exposure."""
        field = self.trained
        latent, steps = dead_zone_through(latent), dead_zone_through(moves)
        feature = field.feature.double() + latent[:, :12] @ self.feature.double()
        offset = field.offset.double() + (latent[:, 12:] @ self.offset.double()).view(field.offset.shape)
        position = field.position.double() + steps * self.step.double()[:, None]
        if field.view_dependent:
            away = position.detach() - self.centre(camera)
            distance = away.norm(dim=1, keepdim=True)
            feature = torch.cat([feature, away / distance, distance / field.reference_distance], dim=1)
        network = (value.double() for value in field.network.parameters())
        return Splats(*decode_reference(feature, offset, field.scaling.double(), position, *network))

    def picture(self, splats: Splats, camera: int) -> Tensor:
        """[H,W,3] as the camera films it, in float64."""
        number = min(camera, len(self.still_splats()) - 1)
        still = Splats(*(part.double() for part in self.still_splats()[number].astuple()))
        gain, offset = self.exposure.gain[camera].double(), self.exposure.offset[camera].double()
        every = join(splats, still)
        every = replace(every, colours=every.colours * gain + offset)
        return rasterise(*every.astuple(), self.cameras[camera], offset, backend="reference").image

    def loss(self, latent: Tensor, position: Tensor, cameras: tuple[int, ...]) -> Tensor:
        """What a step minimises, in float64."""
        found = PRICE * residual_bits_reference(latent, position)
        for camera in cameras:
            image = self.picture(self.splats(latent, position, camera), camera)
            weights = self.weights[camera][..., None].expand(-1, -1, 3).double()
            loss = photometric_reference(image, self.targets[camera].double(), DSSIM, None, weights)
            found = found + loss / len(cameras)
        return found

    def gradients(self, cameras: tuple[int, ...]) -> tuple[float, Tensor]:
        """The loss, and its gradient by latents and positions [n,27]."""
        leaves = [part.double().requires_grad_() for part in (self.latent, self.position)]
        loss = self.loss(*leaves, cameras)
        return float(loss.detach()), torch.cat(torch.autograd.grad(loss, leaves), dim=1)


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
        feature=0.2 * torch.randn(12, 8, generator=g),
        offset=0.1 * torch.randn(12, 3 * SLOTS, generator=g),
        step=0.01 + 0.01 * torch.rand(ANCHORS, generator=g),
        latent=2 * torch.randn(ANCHORS, 24, generator=g) * (torch.rand(ANCHORS, 24, generator=g) < 0.4),
        position=3 * torch.randn(ANCHORS, 3, generator=g),
        targets=torch.rand(3, *size[::-1], 3, generator=g),
        weights=1 + torch.rand(3, *size[::-1], generator=g),
    )


def _camera(angle: float, size: tuple[int, int]) -> Camera:
    eye = 3.2 * np.array([np.sin(angle), -0.2, -np.cos(angle)])
    pose = look_at(eye, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return pinhole(f"at {angle}", (80.0, 82.0), (0.49 * size[0], 0.52 * size[1]), size, pose)


def relative(found: Tensor, wanted: Tensor) -> float:
    """|found - wanted| / |wanted|."""
    return float((found.double() - wanted).norm() / wanted.norm())
