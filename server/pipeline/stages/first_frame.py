"""The first frame of a stream, with pictures for viewers who wait for it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

from streamlod.core.errors import InputError, ModelError
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import Progress, TrainConfig, Trainer
from streamlod.server.pipeline.stages.bounded_queue import Outlet
from streamlod.server.pipeline.stages.draft import draft_scene
from streamlod.server.pipeline.stages.encoding import TrainedState
from streamlod.server.pipeline.stages.figures import report_of, spans_of
from streamlod.server.pipeline.stages.opened import OpenJob
from streamlod.server.pipeline.stages.trace import timing

_LOG = logging.getLogger(__name__)
_PREVIEWS_AT = (0.05, 0.15, 0.3, 0.6)  # fractions of the run
_POINTS_SHARE = 0.3  # of the time to the first frame


class FirstFrame:
    """Trains a first keyframe, and tells how far it is.

    Args:
        opened: the job and its cameras.
        trainer: of the stream, configured by `config`.
        outlet: takes early keyframes.
        previews: whether there are any: a draft, then the training's own.
        on_progress: called on the training thread.
    """

    def __init__(
        self,
        opened: OpenJob,
        trainer: Trainer,
        config: TrainConfig,
        outlet: Outlet[TrainedState],
        previews: bool,
        on_progress: Callable[[Progress], None] | None,
    ) -> None:
        self._opened, self._trainer, self._config = opened, trainer, config
        self._outlet, self._previews, self._on_progress = outlet, previews, on_progress

    def trained(self, frame: FrameSet) -> TrainedState:
        """The keyframe of `frame`; previews have gone out before it, and count as versions."""
        version, due = frame.index, list(_PREVIEWS_AT)

        def show(scene: Scene, fraction: float) -> None:
            nonlocal version
            scene = replace(scene, keyframe=version, version=version)
            self._outlet.put(TrainedState(scene, frame.time_ns, {"fraction": fraction}, preview=True))
            version += 1

        def training(progress: Progress) -> None:
            fraction = _POINTS_SHARE + (1 - _POINTS_SHARE) * progress.fraction
            self._tell(replace(progress, fraction=fraction))
            if self._previews and progress.preview is not None and due and progress.fraction >= due[0]:
                due.pop(0)
                show(progress.preview(), fraction)

        self._tell(Progress("first look", 0.0, 0.0))
        if self._previews and (draft := self._draft(frame)) is not None:
            show(draft, 0.0)
        points, found = timing("train", lambda: self._points(frame))
        trained = self._trainer.keyframe(frame, points, training)
        scene = trained.scene
        self._tell(Progress("first frame", 1.0, trained.report.loss))
        if version != frame.index:
            scene = replace(scene, keyframe=version, version=version)
            self._trainer.resume(scene, keep_references=True)
        spans = (replace(found, name="points"), *spans_of(trained))
        return TrainedState(scene, frame.time_ns, report_of(trained, spans, version), spans=spans)

    def _tell(self, progress: Progress) -> None:
        self._outlet.check()
        if self._on_progress is not None:
            self._on_progress(progress)

    def _draft(self, frame: FrameSet) -> Scene | None:
        """A first picture; None where the cameras cannot give one so fast."""
        job, dataset, rig = self._opened.job, self._opened.dataset, self._opened.rig
        try:
            return draft_scene(
                frame,
                dataset.cameras,
                self._config,
                dataset.fps,
                job.device,
                rig,
                dataset.depth_bounds,
                dataset.points(),
            )
        except (InputError, ModelError) as error:
            _LOG.info("no draft of the first picture: %s", error)
            return None

    def _points(self, frame: FrameSet) -> PointCloud:
        """Points that training begins with."""
        job, dataset = self._opened.job, self._opened.dataset
        return first_points(
            frame,
            dataset.cameras,
            depth_bounds=dataset.depth_bounds,
            method=job.points,
            dataset_points=dataset.points(),
            seed=job.seed,
            progress=lambda done: self._tell(Progress("looking for depth", _POINTS_SHARE * done, 0.0)),
            space=dataset.space,
        )
