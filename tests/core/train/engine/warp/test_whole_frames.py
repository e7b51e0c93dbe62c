"""Whole later frames trained by steps in Warp: as good and as small as those of the Numba kernels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import streamlod.core.train.trainer
from streamlod.codec.encoder import encode_residual
from streamlod.core.arrays import Bool
from streamlod.core.frames import FrameSet
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import PredictConfig, TrainConfig, Trainer, preset
from streamlod.core.train.engine.warp.frame import load_anchors, load_cameras, load_pictures, load_still
from streamlod.core.train.engine.warp.frame_steps import FrameSteps, StepSettings
from streamlod.core.train.engine.warp.room import Capacity, step_room
from streamlod.core.train.engine.warp.step import TrainingStep
from streamlod.core.train.residual.state import State
from streamlod.core.train.residual.trainer import ResidualTrainer, _static_splats
from tests.core.true_points import true_points

FRAMES = 5
KINDS = ("room", "hard", "bright", "theatre")


class WithWarp(ResidualTrainer):
    """The usual frame, whose steps are taken in Warp; nothing else differs."""

    steps: FrameSteps | None = None

    def __init__(self, state: State, dynamic: Bool, *others: Any) -> None:
        super().__init__(state, dynamic, *others)
        self._still = torch.nonzero(state.alive & ~torch.from_numpy(dynamic))[:, 0]

    def _step(self, number: int, config: PredictConfig, decay: float, growth: Any = None) -> Tensor:
        parameters, numbers = self._anchors.optimiser.parameters, self._views.targets[0].numel()
        if self.steps is None:
            self.steps = self._begun(config)
        rates = (decay * rate for rate in (config.latent_rate, config.position_rate, config.group_rate))
        settings = StepSettings(*rates, config.memory, config.rate_weight / numbers, config.dssim_weight)
        loss = self.steps.take((number,), settings, counts=False)
        with torch.no_grad():
            for name, value in parameters.items():
                value.copy_(getattr(self.steps.numbers(), name)[: len(value)])
        return loss

    def _begun(self, config: PredictConfig) -> FrameSteps:
        anchors, views, groups = self._anchors, self._views, self._anchors._groups
        assert groups is not None
        splats = _static_splats(self._all, self._still, self._centres)
        splats = splats if self._all.view_dependent else splats[:1]
        most, (height, width) = max(map(len, splats)), views.targets.shape[1:3]
        capacity = Capacity(
            views=1,
            cameras=len(views.cameras),
            width=width,
            height=height,
            anchors=len(anchors),
            slots=self._all.slots,
            groups=groups.count,
            still=most + 1,
            moving_pairs=1 << 17,
            still_pairs=1 << 19,
            steps=400,
            sees_views=self._all.view_dependent,
        )
        room, unit = step_room(capacity, "cpu"), anchors._unit
        load_cameras(room, views.cameras, self._exposure)
        load_anchors(room, anchors.base, unit.feature, unit.offset, unit.position[:, 0], groups.number, groups.arm)
        load_still(room, splats)
        shown = torch.full_like(views.targets, torch.nan) if self._shown is None else self._shown
        known = [number for number in range(len(shown)) if not shown[number, 0, 0, 0].isnan()]
        weights = 1 + config.changed_weight * self._masks.float()
        load_pictures(room, views.targets, shown.nan_to_num(), weights)
        start = anchors.optimiser.parameters
        return FrameSteps(TrainingStep(room), known, start["latent"].detach(), start["position"].detach())


@dataclass(frozen=True)
class Outcome:
    """Of a clip's later frames: mean PSNR over frames and cameras, and all bytes."""

    quality: float
    size: int


def config() -> TrainConfig:
    live = preset("live")
    keyframe = replace(live.keyframe, steps=150, growth_interval=30)
    predict = replace(live.predict, epochs=6, minimum_steps=24, growth_share=0.0)
    return TrainConfig(replace(live.model, max_anchors=1500), keyframe, predict)


@pytest.mark.slow  # four clips twice
def test_frames_are_as_good_and_as_small(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = [outcomes(kind, monkeypatch) for kind in KINDS]
    assert np.mean([found.quality - usual.quality for usual, found in pairs]) == pytest.approx(0, abs=0.05)
    assert np.mean([found.size / usual.size for usual, found in pairs]) == pytest.approx(1, abs=0.02)


def outcomes(kind: str, patch: pytest.MonkeyPatch) -> tuple[Outcome, Outcome]:
    """Of Numba and of Warp, from one first frame."""
    spec = SyntheticSpec(cameras=4, frames=FRAMES, width=96, height=54, fps=10.0, kind=kind)
    clip = open_synthetic(spec)
    frames = list(clip.frames())
    first = Trainer(clip.cameras, config(), clip.fps, "cpu").keyframe(frames[0], true_points(spec)).scene
    found = []
    for engine in (ResidualTrainer, WithWarp):
        with patch.context() as inside:
            inside.setattr(streamlod.core.train.trainer, "ResidualTrainer", engine)
            trainer = Trainer(clip.cameras, config(), clip.fps, "cpu")
            trainer.resume(first)
            found.append(_outcome(trainer, frames[1:]))
    return found[0], found[1]


def _outcome(trainer: Trainer, frames: list[FrameSet]) -> Outcome:
    size, scores = 0, []
    for frame in frames:
        before, result = trainer.scene, trainer.predict(frame)
        assert result.residual is not None
        size += len(encode_residual(before, result.residual, time_ns=frame.index))
        for camera, picture in zip(trainer._cameras, frame.images, strict=True):
            drawn = render(expand(result.scene, camera.centre), camera, result.scene.header.background)
            scores.append(psnr(drawn.image.clip(0, 1), picture.astype(np.float32) / 255))
    return Outcome(float(np.mean(scores)), size)
