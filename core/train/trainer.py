"""The trainer: the first frame from nothing, then every later frame from the one before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from core.anchors import Scene
from core.arrays import Bool
from core.camera import Camera
from core.errors import ModelError
from core.expand import anchor_positions, dequantise
from core.frames import FrameSet, PointCloud
from core.render import select
from core.residual import Residual, apply
from core.train.config import TrainConfig
from core.train.convert import field_of, level_starts, scene_of
from core.train.exposure import neutral
from core.train.field import Field
from core.train.keyframe import KeyframeTrainer, Views
from core.train.online import ResidualTrainer, no_quanta, residual_of
from core.train.partition import change_masks, partition, rendered, renewed_references
from core.train.progress import FrameReport, Progress, ProgressCallback, Stopwatch, TrainedFrame
from core.train.seeding import seed_field

_REPORT_EVERY = 25


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """What the next frame starts from.

    Attributes:
        scene: the decoder's integer state; field: the same, dequantised.
        canonical: the keyframe's field, for the paper's motion cue.
        references: [C,H,W,3] what the state was trained to show, NaN for cameras not seen yet; None after a resume.
        shown: [C,H,W,3] what the state shows, NaN where that is not known; None likewise.
        dynamic: [N] trained in the latest frame.
    """

    scene: Scene
    field: Field
    canonical: Field
    references: Tensor | None
    shown: Tensor | None
    dynamic: Bool


class Trainer:
    """Trains one stream, a frame at a time.

    Args:
        cameras: of the training pictures, in the order of `FrameSet.images`.
        config: the method.
        fps: frames a second, told to viewers.
        device: ``auto``, ``cpu`` or ``cuda``.
        rig: cameras offered to viewers as places to stand; the training cameras by default.
    """

    def __init__(
        self,
        cameras: tuple[Camera, ...],
        config: TrainConfig,
        fps: float,
        device: str = "auto",
        rig: tuple[Camera, ...] | None = None,
    ) -> None:
        self._cameras, self._config, self._fps = cameras, config, fps
        self._backend = select(device)
        self._rig = rig or cameras
        self._device = "cuda" if self._backend == "cuda" else "cpu"
        self._exposure = neutral(len(cameras), self._device)
        self._state: _State | None = None

    @property
    def scene(self) -> Scene:
        """The state after the latest frame.

        Raises:
            ModelError: no frame has been trained yet.
        """
        return self._require().scene

    def keyframe(
        self, frames: FrameSet, points: PointCloud, on_progress: ProgressCallback | None = None
    ) -> TrainedFrame:
        """Train the first frame from `points`, or a later one anew; the result is a keyframe.

        Raises:
            ModelError: no camera is present, or too few points.
        """
        watch, views = Stopwatch(), self._views(frames)
        with watch.stage("seed"):
            generator = torch.Generator().manual_seed(self._config.seed)
            field = seed_field(points, self._cameras, self._config.model, generator).to(self._device)
            trainer = KeyframeTrainer(field, views, self._config, self._backend)

        def preview() -> Scene:
            return self._scene_of(trainer.field, frames.index)

        steps, losses = self._config.keyframe.steps, list[Tensor]()
        with watch.stage("train"):
            for step in range(steps):
                losses.append(trainer.step())
                if on_progress is not None and (step + 1) % _REPORT_EVERY == 0:
                    mean = float(torch.stack(losses[-_REPORT_EVERY:]).mean())
                    on_progress(Progress("first frame", (step + 1) / steps, mean, len(trainer.field), preview))
        with watch.stage("round"):
            scene = preview()
            self._exposure = trainer.exposure
            self._adopt(scene, views)
        report = FrameReport(
            watch.seconds,
            steps,
            scene.anchor_count,
            scene.anchor_count,
            float(torch.stack(losses[-50:]).mean()),
            trainer.broken,
            tuple(watch.spans),
        )
        return TrainedFrame(scene, None, report)

    @property
    def has_state(self) -> bool:
        """Whether there is a state to predict from."""
        return self._state is not None

    def resume(self, scene: Scene, *, keep_references: bool = False) -> None:
        """Go on from `scene`, which another trainer left before a crash, or which is this one's state as a keyframe.

        Args:
            keep_references: the scene shows what this trainer's state showed.
        """
        references = self._state.references if keep_references and self._state is not None else None
        field = field_of(scene).to(self._device)
        self._state = _State(scene, field, field, references, None, np.zeros(_rows(scene), np.bool_))

    def predict(self, frames: FrameSet) -> TrainedFrame:
        """Train a later frame; its residual leads from the state before.

        Raises:
            ModelError: no keyframe came before, or no camera is present.
        """
        state, watch, views = self._require(), Stopwatch(), self._views(frames)
        config = self._config.predict
        alive = _alive(state.scene).to(self._device)
        with watch.stage("partition"):
            references, shown, unknown = self._known_pictures(state, alive, views)
            masks = change_masks(references, views, config.noise_floor)
            due = frames.index % config.partition_interval == 0 or not state.dynamic.any()
            dynamic = state.dynamic & alive.cpu().numpy()
            if due:
                source = state.canonical if config.cue == "canonical" else state.field
                dynamic = partition(source, alive, references, views, masks, dynamic, config, self._backend)
        rows = torch.from_numpy(np.flatnonzero(dynamic)).to(self._device)
        quanta, trainer = no_quanta(0), None
        if len(rows):
            with watch.stage("train"):
                static = torch.nonzero(alive & ~torch.from_numpy(dynamic).to(self._device))[:, 0]
                exposure = self._exposure if self._config.model.exposure else None
                trainer = ResidualTrainer(state.scene, state.field, rows, static, views, exposure, shown)
                generator = torch.Generator().manual_seed(self._config.seed + frames.index)
                quanta = trainer.run(config, self._backend, generator)
        with watch.stage("round"):
            residual = residual_of(state.scene, rows.cpu().numpy(), quanta, frames.index)
            scene = apply(state.scene, residual)
            state = _next(state, scene, residual, references, dynamic)
        with watch.stage("settle"):
            if trainer is not None:
                alive = _alive(scene).to(self._device)
                if len(alive) == trainer.anchors:
                    shown = trainer.show(state.field, rows[alive[rows]])
                else:  # anchors were added, and rows are numbered anew
                    shown = rendered(state.field, alive, views, self._backend)
            if masks.any():
                references = renewed_references(references, shown, views, masks, config.unsettled_floor)
            for number in unknown:  # trained on for the first time: its static error is nothing that moves
                references[number] = views.targets[number]
            self._state = replace(state, references=references, shown=shown)
        report = FrameReport(
            watch.seconds,
            quanta.steps,
            scene.anchor_count,
            len(rows),
            quanta.loss,
            quanta.repaired,
            tuple(watch.spans),
        )
        return TrainedFrame(scene, residual, report)

    def _views(self, frames: FrameSet) -> Views:
        usable = np.flatnonzero(frames.present).tolist()
        if not usable:
            raise ModelError(f"frame {frames.index} has no picture from any camera")
        targets = torch.from_numpy(frames.images).to(self._device).float().div_(255)
        return Views(self._cameras, targets, usable)

    def _scene_of(self, field: Field, version: int) -> Scene:
        return scene_of(field, self._config.predict, self._rig, self._fps, version)

    def _adopt(self, scene: Scene, views: Views) -> None:
        field = field_of(scene).to(self._device)
        references = torch.full_like(views.targets, torch.nan)
        references[views.usable] = views.targets[views.usable]
        self._state = _State(scene, field, field, references, None, np.zeros(_rows(scene), np.bool_))

    def _known_pictures(self, state: _State, alive: Tensor, views: Views) -> tuple[Tensor, Tensor, list[int]]:
        """References, and what the state shows, for every usable camera; and the numbers of those without references.

        A camera has none after a resume, and when it joins late; what the state shows it now must do.
        """
        nothing = torch.full_like(views.targets, torch.nan)
        references = nothing if state.references is None else state.references
        shown = nothing if state.shown is None else state.shown
        unknown = [number for number in views.usable if bool(references[number, 0, 0, 0].isnan())]
        missing = [number for number in views.usable if bool(shown[number, 0, 0, 0].isnan())]
        if missing:
            pictures = rendered(state.field, alive, replace(views, usable=missing), self._backend)
            shown = shown.clone()
            shown[missing] = pictures[missing]
        if unknown:
            references = references.clone()
            references[unknown] = shown[unknown]
        return references, shown, unknown

    def _require(self) -> _State:
        if self._state is None:
            raise ModelError("there is no state to go on from: train a keyframe or resume a scene first")
        return self._state


def _alive(scene: Scene) -> Tensor:
    return torch.from_numpy(np.concatenate([level.alive for level in scene.levels]))


def _rows(scene: Scene) -> int:
    return int(level_starts(scene)[-1])


def _next(state: _State, scene: Scene, residual: Residual, references: Tensor, dynamic: Bool) -> _State:
    """The state after `residual` led to `scene`; changed rows are dequantised again, as the decoder does it."""
    if any(len(part.added) for part in residual.levels):
        return _relaid(state, scene, residual, references, dynamic)
    field, starts = state.field, level_starts(scene)
    device = field.feature.device
    feature, offset, position = field.feature.clone(), field.offset.clone(), field.position.clone()
    for number, (level, part) in enumerate(zip(scene.levels, residual.levels, strict=True)):
        if len(part.rows) == 0:
            continue
        rows = torch.from_numpy(part.rows + starts[number]).to(device)
        new_feature, new_offset, _ = dequantise(scene.header, scene.weights, level, part.rows)
        feature[rows] = torch.from_numpy(new_feature).to(device)
        offset[rows] = torch.from_numpy(new_offset).to(device)
        position[rows] = torch.from_numpy(anchor_positions(scene.header, number, level)[part.rows]).to(device)
    field = replace(field, feature=feature, offset=offset, position=position)
    return replace(state, scene=scene, field=field, references=references, dynamic=dynamic)


def _relaid(state: _State, scene: Scene, residual: Residual, references: Tensor, dynamic: Bool) -> _State:
    """As `_next`, where anchors were added: rows of finer levels move up; newcomers count as dynamic."""
    device = str(state.field.feature.device)
    before, parts = level_starts(state.scene), []
    for number, part in enumerate(residual.levels):
        parts += [np.arange(before[number], before[number + 1]), np.full(len(part.added), -1)]
    origin = np.concatenate(parts)
    field, is_new = field_of(scene).to(device), origin < 0
    new = torch.from_numpy(np.flatnonzero(is_new)).to(device)
    canonical = state.canonical.with_rows(torch.from_numpy(np.maximum(origin, 0)).to(device)).with_values(new, field)
    return replace(
        state,
        scene=scene,
        field=field,
        canonical=canonical,
        references=references,
        dynamic=np.where(is_new, True, dynamic[np.maximum(origin, 0)]),
    )
