"""The trainer: the first frame from nothing, then every later frame from the one before."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.errors import ModelError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.render import backends, select
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.exposures import NEUTRAL
from streamlod.core.scene.keyframe import as_keyframe
from streamlod.core.train.config import TrainConfig
from streamlod.core.train.control.frame_budget import FrameBudget
from streamlod.core.train.control.rate_control import UNLIMITED, RateControl
from streamlod.core.train.engine.named import named_engine
from streamlod.core.train.field.convert import motion_cell_of, scene_of
from streamlod.core.train.field.exposure import Exposure, exposure_of, fitted, neutral
from streamlod.core.train.field.rendered import rendered
from streamlod.core.train.growth.near_space import near_space
from streamlod.core.train.keyframe.refresh import refresh_config
from streamlod.core.train.keyframe.seeding import seed_field
from streamlod.core.train.keyframe.trainer import KeyframeTrainer
from streamlod.core.train.later_frame.colour_drift import followed, without_drift
from streamlod.core.train.later_frame.frame import Means, train_later_frame
from streamlod.core.train.later_frame.references import as_filmed
from streamlod.core.train.later_frame.state import KnownPictures, State, fresh_state, no_pictures
from streamlod.core.train.pictures.uploading import Uploader
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.progress import FrameReport, Progress, ProgressCallback, Stopwatch, TrainedFrame

_REPORT_EVERY = 25


class Trainer:
    """Trains one stream, a frame at a time.

    Args:
        cameras: of the training pictures, in the order of `FrameSet.images`.
        config: the method.
        fps: frames a second, told to viewers.
        device: ``auto``, ``cpu`` or ``cuda``.
        rig: cameras offered to viewers as places to stand, near which nothing is hidden from them
            (`core.scene.expand.near_radius`); the training cameras by default.
        frame_budget_ms: wall time for each later frame, None for as long as it takes. `sent` tells what encoding took.
        target_kbps: kilobits a second that predicted packets may take, None for any; needs `sent` after every frame.
        clock: seconds that the budget and the report go by.
    """

    def __init__(
        self,
        cameras: tuple[Camera, ...],
        config: TrainConfig,
        fps: float,
        device: str = "auto",
        rig: tuple[Camera, ...] | None = None,
        frame_budget_ms: float | None = None,
        target_kbps: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._cameras, self._config, self._fps = cameras, config, fps
        self._backend = select(device)
        self._rig = rig or cameras
        self._device = backends.GPU if self._backend in backends.ON_GPU else "cpu"
        self._engine_of = named_engine(config, self._backend, self._device)
        self._exposure = neutral(len(cameras), self._device)
        self._drift = neutral(len(cameras), self._device)  # of the cameras' exposures since the latest first frame
        self._refit_exposure = False
        self._first_count = 0  # anchors of the first frame since the start
        self._clock = clock
        self._budget = FrameBudget(frame_budget_ms, clock)
        self._rate = None if target_kbps is None else RateControl(target_kbps, fps)
        self._uploader = Uploader(self._device)
        self._state: State | None = None

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
            space = near_space(points, self._cameras) if self._config.keyframe.clearance > 0 else None
            exposure, cell = neutral(len(self._cameras), self._device), field.octree.motion_cell
            trainer = KeyframeTrainer(field, views, self._config, self._backend, exposure, cell, space)

        def preview() -> Scene:
            return self._scene_of(trainer, frames.index)

        with watch.stage("train"):
            losses = _run(trainer, "first frame", on_progress, preview)
        with watch.stage("round"):
            scene = preview()
            self._exposure, self._first_count = trainer.exposure, scene.anchor_count
            self._drift = neutral(len(self._cameras), self._device)
            self._state = as_filmed(self._fresh(scene), views, views.usable)
        return _as_keyframe(scene, losses, trainer.broken, watch)

    def refresh(self, frames: FrameSet, on_progress: ProgressCallback | None = None) -> TrainedFrame:
        """A keyframe of the latest state, trained on as configured against `frames`, which that state shows.

        The state is sent as it is under a frame budget, which has no time for a run; where nothing has changed since
        the keyframe before; and where no anchor is alive.

        Raises:
            ModelError: there is no state, or no camera is present.
        """
        state, watch = self._require(), Stopwatch(self._clock)
        untrained = self._config.keyframe.refresh_steps == 0 or state.scene.anchor_count == 0 or state.is_untouched
        if untrained or self._budget.is_limited:
            scene = self._telling(as_keyframe(state.scene, state.scene.version), self._exposure)
            self.resume(scene, keep_references=True)
            return TrainedFrame(scene, None, FrameReport({}, 0, scene.anchor_count, scene.anchor_count, 0.0))
        views = without_drift(self._views(frames), self._drift, state.known.references)
        with watch.stage("refresh"):
            # which anchors a step draws is left to training
            field = replace(state.field.with_rows(torch.nonzero(state.alive)[:, 0]), by_distance=False)
            config = refresh_config(self._config, field, state.scene.version, self._first_count)
            cell = motion_cell_of(state.scene, self._config.predict)
            trainer = KeyframeTrainer(field, views, config, self._backend, self._exposure, cell)
            losses = _run(trainer, "keyframe", on_progress)
            self._exposure = trainer.exposure
            scene = self._scene_of(trainer, state.scene.version)
            known = replace(state.known, shown=torch.full_like(state.known.shown, torch.nan))
            self._state = as_filmed(self._fresh(scene, known), views, views.usable)
        return _as_keyframe(scene, losses, trainer.broken, watch)

    @property
    def has_state(self) -> bool:
        """Whether there is a state to predict from."""
        return self._state is not None

    def resume(self, scene: Scene, *, keep_references: bool = False) -> None:
        """Go on from `scene`, which another trainer left before a crash, or which is this one's state as a keyframe.

        Args:
            keep_references: the scene shows what this trainer's state showed.
        """
        self._first_count = self._first_count or scene.anchor_count
        if keep_references and self._state is not None:
            self._state = self._fresh(scene, self._state.known)
        else:
            if self._state is None:  # after a crash
                told, rig = scene.metadata.exposures or (), scene.header.cameras
                known = {camera.name: exposure for camera, exposure in zip(rig, told, strict=False)}
                if all(camera.name in known for camera in self._cameras):
                    self._exposure = exposure_of([known[camera.name] for camera in self._cameras], self._device)
                else:
                    self._refit_exposure = True
            self._state = self._fresh(scene)

    def prepare(self, frames: FrameSet) -> None:
        """Begin to send the pictures of a frame that is trained soon to a GPU; from any thread, without waiting."""
        if self._device != "cpu":
            self._uploader.begin(frames)

    def predict(self, frames: FrameSet) -> TrainedFrame:
        """Train a later frame; its residual leads from the state before.

        Raises:
            ModelError: no keyframe came before, or no camera is present.
        """
        state, watch, views = self._require(), Stopwatch(self._clock), self._views(frames)
        self._budget.start()
        with watch.stage("compare"):
            state, unknown = self._with_pictures(state, views)
            views = self._without_drift(views, state.known.references, unknown)
        means = Means(
            config=self._config,
            plan=UNLIMITED if self._rate is None else self._rate.plan(),
            backend=self._backend,
            engine_of=self._engine_of,
            exposure=self._exposure,
            first_count=self._first_count,
            budget=self._budget,
            watch=watch,
        )
        done = train_later_frame(state, views, frames.index, means)
        # trained on for the first time: its static error is nothing that moves
        self._state = as_filmed(done.state, views, unknown) if unknown else done.state
        for stage, spent in watch.seconds.items():
            self._budget.spent(stage, spent)
        update, scene = done.update, done.state.scene
        report = FrameReport(
            watch.seconds,
            update.steps,
            scene.anchor_count,
            int(done.dynamic.sum()),
            update.loss,
            update.repaired,
            tuple(watch.spans),
        )
        return TrainedFrame(scene, done.residual, report, done.dynamic)

    def sent(self, frame: TrainedFrame, size_bytes: int, seconds: float = 0.0) -> None:
        """Learn what `frame` took as a packet; the frame budget and the rate control go by it.

        Args:
            size_bytes: of the packet.
            seconds: that encoding it took.
        """
        self._budget.spent("encode", seconds)
        if self._rate is not None:
            if frame.residual is None:
                self._rate.sent_keyframe(size_bytes)
            else:
                self._rate.sent(size_bytes, frame.residual.changed)

    def _views(self, frames: FrameSet) -> Views:
        usable = np.flatnonzero(frames.present).tolist()
        if not usable:
            raise ModelError(f"frame {frames.index} has no picture from any camera")
        return Views(self._cameras, self._uploader.take(frames), usable)

    def _without_drift(self, views: Views, references: Tensor, unknown: list[int]) -> Views:
        """`views` as cameras would film them that had not drifted since they were first seen; `unknown` are now."""
        if not self._config.model.exposure:
            return views
        known = [number for number in views.usable if number not in unknown]
        self._drift = followed(self._drift, views, references, known)
        return without_drift(views, self._drift, references)

    def _scene_of(self, trainer: KeyframeTrainer, version: int) -> Scene:
        precision, cell = trainer.precision, trainer.motion_cell
        scene = scene_of(trainer.field, self._config.predict, self._rig, self._fps, version, precision, cell)
        return self._telling(scene, trainer.exposure)

    def _telling(self, scene: Scene, exposure: Exposure) -> Scene:
        """`scene`, which tells players how its cameras show it now: at `exposure`, and drifted since."""
        if not self._config.model.exposure:
            return scene
        names = (camera.name for camera in self._cameras)
        known = dict(zip(names, exposure.then(self._drift).of_cameras(), strict=True))
        told = tuple(known.get(camera.name, NEUTRAL) for camera in self._rig)  # some of the rig's may not train
        return replace(scene, metadata=replace(scene.metadata, exposures=told))

    def _fresh(self, scene: Scene, known: KnownPictures | None = None) -> State:
        known = no_pictures(self._cameras, self._device) if known is None else known
        return fresh_state(scene, self._device, known, by_distance=self._config.model.selection == "distance")

    def _with_pictures(self, state: State, views: Views) -> tuple[State, list[int]]:
        """The state with references for every usable camera, and the numbers of those that had none.

        A camera has none after a resume, and when it joins late; what the state shows it now must do.
        """
        known = state.known
        unknown = [number for number in views.usable if bool(known.references[number, 0, 0, 0].isnan())]
        if not unknown:
            return state, unknown
        pictures = rendered(state.field, state.alive, replace(views, usable=unknown), self._backend)
        if self._config.model.exposure and self._refit_exposure:
            self._exposure = fitted(pictures, views.targets, unknown)
            self._refit_exposure = False
        pictures = torch.stack([self._exposure.apply(picture, number) for number, picture in enumerate(pictures)])
        references, shown = _where_known(pictures, known.references), _where_known(pictures, known.shown)
        return replace(state, known=KnownPictures(references, _where_known(known.filmed, references), shown)), unknown

    def _require(self) -> State:
        if self._state is None:
            raise ModelError("there is no state to go on from: train a keyframe or resume a scene first")
        return self._state


def _run(
    trainer: KeyframeTrainer,
    stage: str,
    on_progress: ProgressCallback | None,
    preview: Callable[[], Scene] | None = None,
) -> list[Tensor]:
    """Train to the end, telling `on_progress` now and then; returns the losses."""
    losses = list[Tensor]()
    while trainer.progress < 1:
        losses.append(trainer.step())
        if on_progress is not None and len(losses) % _REPORT_EVERY == 0:
            mean = float(torch.stack(losses[-_REPORT_EVERY:]).mean())
            on_progress(Progress(stage, trainer.progress, mean, preview))
    return losses


def _as_keyframe(scene: Scene, losses: list[Tensor], broken: int, watch: Stopwatch) -> TrainedFrame:
    """A run's `scene`, with the figures of the run."""
    loss, count = float(torch.stack(losses[-50:]).mean()), scene.anchor_count
    report = FrameReport(watch.seconds, len(losses), count, count, loss, broken, tuple(watch.spans))
    return TrainedFrame(scene, None, report)


def _where_known(pictures: Tensor, otherwise: Tensor) -> Tensor:
    """[C,H,W,3] `pictures` in [0, 1]; those of `otherwise` for cameras without one."""
    return torch.stack(
        [other if one[0, 0, 0].isnan() else one.clamp(0, 1) for one, other in zip(pictures, otherwise, strict=True)]
    )
