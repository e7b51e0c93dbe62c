"""Training one later frame: quantised residuals of the dynamic anchors only (paper section III-C).

The state is the decoder's: every frame starts from dequantised integers and ends by rounding, so encoder and decoder
cannot drift apart. Between the rounds the latents are real numbers whose forward pass is rounded (straight-through).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from core.anchors import FEATURE_LATENTS, LATENTS, Scene, empty_level
from core.arrays import Int32, Int64
from core.render.backends import Backend
from core.residual import LevelResidual, Residual
from core.train.config import PredictConfig
from core.train.convert import level_starts
from core.train.decode import Splats, decode
from core.train.exposure import Exposure
from core.train.field import Field
from core.train.keyframe import Views
from core.train.losses import photometric_loss
from core.train.optimiser import RowAdam
from core.train.rounding import round_through
from core.train.schedule import ViewOrder
from core.train.stage import Stage, make_stage


@dataclass(frozen=True, slots=True, eq=False)
class Quanta:
    """Integer differences of n anchors: latent [n,24] and position [n,3], both int32, with the training's figures."""

    latent: Int32
    position: Int32
    steps: int
    loss: float
    repaired: int


class ResidualTrainer:
    """Fits the residuals of `rows` of `field` to one instant.

    Args:
        field: the dequantised state of `scene`.
        rows: [n] rows of the dynamic anchors.
        static: [m] rows of the other anchors alive.
        views: pictures of the instant.
    """

    def __init__(
        self, scene: Scene, field: Field, rows: Tensor, static: Tensor, views: Views, exposure: Exposure | None
    ) -> None:
        self._field, self._rows, self._views, self._exposure = field, rows, views, exposure
        device = field.feature.device
        self._background = torch.zeros(3, device=device)
        self._centres = [torch.from_numpy(camera.centre).float().to(device) for camera in views.cameras]
        self._feature_decoder = torch.from_numpy(scene.weights.feature_decoder).to(device)
        self._offset_decoder = torch.from_numpy(scene.weights.offset_decoder).to(device)
        steps = torch.from_numpy(scene.header.position_steps).to(device)
        self._position_step = steps[field.level[rows]][:, None]
        self._latent = torch.zeros(len(rows), LATENTS, device=device, requires_grad=True)
        self._position = torch.zeros(len(rows), 3, device=device, requires_grad=True)
        self._static = _static_splats(field, static, self._centres)
        self._stages: dict[int, Stage] = {}

    def run(self, config: PredictConfig, backend: Backend, generator: torch.Generator) -> Quanta:
        """Train as configured and round."""
        with torch.no_grad():
            for number in self._views.usable:
                self._stages[number] = self._stage(number, self._dynamic_splats(number), backend)
        views = [number for number in self._views.usable if not self._stages[number].is_empty]
        if not views:
            return _nothing(len(self._rows))
        total = max(config.epochs * len(views), config.minimum_steps)
        order, optimiser = ViewOrder(views, generator), RowAdam({"latent": self._latent, "position": self._position})
        losses: list[Tensor] = []
        for step in range(total):
            loss = self._loss(order.next(), config, backend)
            loss.backward()  # type: ignore[no-untyped-call]
            decay = config.final_rate ** (step / total)
            optimiser.step({"latent": config.latent_rate * decay, "position": config.position_rate * decay})
            losses.append(loss.detach())
        latent, position = _finite_quanta(self._latent), _finite_quanta(self._position)
        return Quanta(latent, position, total, float(torch.stack(losses[-len(views) :]).mean()), optimiser.broken)

    def _loss(self, number: int, config: PredictConfig, backend: Backend) -> Tensor:
        dynamic = self._dynamic_splats(number)
        stage = self._stages[number]
        if not stage.covers(dynamic):
            stage = self._stages[number] = self._stage(number, dynamic.detached(), backend)
        render = stage.render(dynamic, self._background, backend)
        image = render if self._exposure is None else self._exposure.apply(render, number)
        loss = photometric_loss(image, self._views.targets[number], config.dssim_weight, stage.region)
        if config.rate_weight:
            bits = torch.log2(1 + self._latent.abs()).sum() + torch.log2(1 + self._position.abs()).sum()
            loss = loss + config.rate_weight * bits / image.numel()
        return loss

    def _stage(self, number: int, dynamic: Splats, backend: Backend) -> Stage:
        return make_stage(self._views.cameras[number], dynamic, self._static[number], self._background, backend)

    def _dynamic_splats(self, number: int) -> Splats:
        field, rows = self._field, self._rows
        latent, position = round_through(self._latent), round_through(self._position)
        offset = latent[:, FEATURE_LATENTS:] @ self._offset_decoder
        return decode(
            field.feature[rows] + latent[:, :FEATURE_LATENTS] @ self._feature_decoder,
            field.offset[rows] + offset.reshape(len(rows), -1, 3),
            field.scaling[rows],
            field.position[rows] + position * self._position_step,
            field.network,
            field.view(self._centres[number]),
        )


def _static_splats(field: Field, static: Tensor, centres: list[Tensor]) -> list[Splats]:
    """Gaussians that are only drawn, for each camera; decoded once for all where they look the same to all."""
    decoded: list[Splats] = []
    for centre in centres:
        if decoded and not field.view_dependent:
            decoded.append(decoded[0])
            continue
        with torch.no_grad():
            splats = field.decode(centre, static)
        decoded.append(splats.rows(torch.nonzero(splats.opacities > 0)[:, 0]))
    return decoded


def residual_of(scene: Scene, rows: Int64, quanta: Quanta, version: int) -> Residual:
    """The residual of `scene` to `version` that `quanta` of `rows` (numbered over all levels) stand for."""
    starts = level_starts(scene)
    changed = quanta.latent.any(axis=1) | quanta.position.any(axis=1)
    rows, latent, position = rows[changed], quanta.latent[changed], quanta.position[changed]
    levels = []
    for number, level in enumerate(scene.levels):
        here = (rows >= starts[number]) & (rows < starts[number + 1])
        own = rows[here] - starts[number]
        total = np.clip(level.latent[own].astype(np.int64) + latent[here], -32768, 32767)
        levels.append(
            LevelResidual(
                rows=own,
                position=position[here],
                latent=(total - level.latent[own]).astype(np.int32),
                removed=np.zeros(0, np.int64),
                added=empty_level(level.feature.shape[1], scene.header.gaussians_per_anchor),
            )
        )
    return Residual(scene.keyframe, scene.version, version, tuple(levels))


def _nothing(anchors: int) -> Quanta:
    return Quanta(np.zeros((anchors, LATENTS), np.int32), np.zeros((anchors, 3), np.int32), 0, 0.0, 0)


def _finite_quanta(values: Tensor) -> Int32:
    """Nearest integers; what is not finite stays at its last good state, zero."""
    limit = 2.0**24
    rounded = torch.nan_to_num(values.detach(), 0.0, 0.0, 0.0).round().clamp(-limit, limit)
    return rounded.to(torch.int32).cpu().numpy()
