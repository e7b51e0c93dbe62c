"""The stage between reading and encoding: each frame is trained, the first one from nothing."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

from streamlod.codec.refresh import RefreshRule, RefreshSchedule
from streamlod.core.frames import FrameSet
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import Progress, Trainer, preset
from streamlod.core.train.presets.settings import with_settings
from streamlod.server.pipeline.rehearsal import rehearse
from streamlod.server.pipeline.stages.bounded_queue import Outlet
from streamlod.server.pipeline.stages.dark_start import contrast, contrast_of_scene, is_worth_anew
from streamlod.server.pipeline.stages.encoding import KeyframeSize, TrainedState
from streamlod.server.pipeline.stages.figures import report_of, spans_of
from streamlod.server.pipeline.stages.first_frame import FirstFrame
from streamlod.server.pipeline.stages.opened import OpenJob
from streamlod.server.pipeline.stages.trace import timing

_LOG = logging.getLogger(__name__)


class TrainingStage:
    """Trains the frames of a job and puts their states into `outlet`.

    Args:
        opened: the job and its cameras.
        previews: whether early keyframes go out while the first frame trains.
        on_progress: of the first frame, called on the training thread.
        size: of keyframes, as the encoding stage finds it.
        outlet: takes the states.
    """

    def __init__(
        self,
        opened: OpenJob,
        previews: bool,
        on_progress: Callable[[Progress], None] | None,
        size: KeyframeSize,
        outlet: Outlet[TrainedState],
    ) -> None:
        job, dataset = opened.job, opened.dataset
        self._job, self._opened, self._outlet = job, opened, outlet
        config = replace(with_settings(preset(job.preset), job.set or {}), seed=job.seed)
        self._trainer = Trainer(
            dataset.cameras,
            config,
            dataset.fps,
            job.device,
            opened.rig,
            frame_budget_ms=job.frame_budget_ms,
            target_kbps=job.target_kbps,
        )
        self._first = FirstFrame(opened, self._trainer, config, outlet, previews, on_progress)
        self._refresh = RefreshSchedule(RefreshRule(max_age=job.keyframe_interval), size.size_bytes)
        self._first_contrast = 0.0  # of the pictures that the first frame was trained of

    def run(self, resume: Scene | None, start: int) -> None:
        """Train all frames from `start`, after the state to resume if there is one."""
        if self._job.frame_budget_ms is not None:
            rehearse(self._job.preset, self._job.device)  # so that the first frames spend no time on loading code
        shift = 0
        if resume is not None:
            self._trainer.resume(resume)
            self._first_contrast = contrast_of_scene(resume, self._opened.dataset.cameras)
            shift = resume.version + 1 - start
        with closing(self._opened.frames(start, self._trainer.prepare)) as frames:
            for filmed, read in frames:
                captured = None if filmed.latency_ns is None else read.end - filmed.latency_ns / 1e9
                frame = replace(filmed, index=filmed.index + shift)
                if self._trainer.has_state and not self._begins_anew(frame):
                    trained = self._later(frame)
                else:
                    self._first_contrast = contrast(frame)
                    trained = self._first.trained(frame)
                    shift = trained.scene.version - filmed.index
                self._outlet.put(replace(trained, spans=(read, *trained.spans), captured=captured))

    def _begins_anew(self, frame: FrameSet) -> bool:
        """Whether the first frame had too little in it, and this one has something; see `dark_start`."""
        if not is_worth_anew(self._first_contrast, frame):
            return False
        _LOG.info("version %d: trained anew, as there was next to nothing in the first pictures", frame.index)
        return True

    def _report_refresh(self, progress: Progress) -> None:
        self._outlet.check()
        _LOG.debug("keyframe: %.0f %% of its training done", 100 * progress.fraction)

    def _later(self, frame: FrameSet) -> TrainedState:
        """One later frame: its residual, and from time to time a refresh keyframe of the same instant after it."""
        before = self._trainer.scene
        trained = self._trainer.predict(frame)
        assert trained.residual is not None
        scene, refresh, spans = trained.scene, None, spans_of(trained)
        if self._refresh.due(before, scene) is not None:
            _LOG.info("version %d: a refresh keyframe", scene.version)
            keyframe = self._trainer.refresh(frame, self._report_refresh)
            refresh, spans = keyframe.scene, (*spans, *spans_of(keyframe))
        report = report_of(trained, spans, scene.version)
        state = TrainedState(scene, frame.time_ns, report, (before, trained.residual), refresh, spans=spans)
        if self._job.target_kbps is None:
            return state
        packet, span = timing("encode", state.changing)
        self._trainer.sent(trained, len(packet), span.end - span.begin)
        return replace(state, packet=packet)
