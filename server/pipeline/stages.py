"""From pictures to packets: a pipeline of data set, trainer and codec.

Three stages run in parallel: while frame t trains, pictures of frame t + 1 are read, and frame t - 1 is encoded and
passed on. `train_stream` is what the worker process runs; `train_clip` writes a clip into a file.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.codec.container import SlodWriter
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.mp4.sound import SoundPiece
from streamlod.codec.refresh import RefreshRule, RefreshSchedule, keyframe_bytes
from streamlod.core.camera import Camera
from streamlod.core.camera.space import space_of
from streamlod.core.data import Dataset, open_dataset, prefetch, training_cameras
from streamlod.core.errors import InputError, ModelError, StreamlodError, TrainingCutShort
from streamlod.core.files import write_text
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.options import MAX_CAMERAS
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.metadata import Metadata
from streamlod.core.scene.residual import Residual
from streamlod.core.synthetic import open_synthetic
from streamlod.core.train import Progress, TrainedFrame, Trainer, preset
from streamlod.core.train.presets.settings import with_settings
from streamlod.server.ingest.live import LiveDataset, open_live
from streamlod.server.ingest.statistics import Statistics
from streamlod.server.pipeline.bounded_queue import Outlet, made_by
from streamlod.server.pipeline.checks import synthetic_spec
from streamlod.server.pipeline.dark_start import contrast, contrast_of_scene, is_dark, is_worth_anew
from streamlod.server.pipeline.draft import draft_scene
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.rehearsal import rehearse
from streamlod.server.pipeline.sound import AUTO, choose_sound, write_beside
from streamlod.server.pipeline.trace import Span, timed, timing

_LOG = logging.getLogger(__name__)
_PREFETCHED = 2  # frames decoded ahead
_PREVIEWS_AT = (0.05, 0.15, 0.3, 0.6)  # fractions of the first frame's run
_POINTS_SHARE = 0.3  # of the time to the first frame


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """One frame's packets with the figures of its training.

    Attributes:
        version: of the state that the packets lead to.
        packets: one, or two where a new keyframe follows the frame's residual.
        report: figures, as JSON values.
        preview: whether the packet is an early, unfinished keyframe.
        spans: when its stages ran.
    """

    version: int
    packets: tuple[bytes, ...]
    report: dict[str, Any]
    preview: bool = False
    spans: tuple[Span, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OpenJob:
    """A job's data set, reduced to the cameras it trains on, and the whole rig.

    Attributes:
        on_read: called with each frame as soon as it is read, on the reading thread.
    """

    job: TrainJob
    dataset: Dataset | LiveDataset
    rig: tuple[Camera, ...]
    on_read: Callable[[FrameSet], None] = lambda _: None

    @property
    def stop(self) -> int | None:
        """Number of the frame before which the job ends; None for live cameras without an end."""
        stop, count = self.job.frames, self.dataset.frame_count
        return stop if count is None else count if stop is None else min(stop, count)

    def frames(self, start: int, announce: Callable[[FrameSet], None]) -> Generator[tuple[FrameSet, Span], None, None]:
        """The job's frames from `start`, with the time that reading took.

        Files are read ahead of training. Live frames are not: one read ahead would be old when training takes it.

        Args:
            announce: called as `on_read`.
        """
        announced = _announced(self.dataset.frames(start, self.stop), self.on_read, announce)
        frames = timed(announced, "read")
        return frames if isinstance(self.dataset, LiveDataset) else prefetch(frames, _PREFETCHED)

    @property
    def facts(self) -> Metadata:
        """Title and licence of the scene, as the job has them."""
        return Metadata(title=self.job.title, licence=self.job.licence)

    def continuing(self, scene: Scene) -> OpenJob:
        """The same job with its cameras where `scene` has them, which may come from another calibration's space."""
        space = space_of(self.rig, scene.header.cameras)
        if space is None:
            return self
        dataset = self.dataset.placed(space.after(self.dataset.space))
        return replace(self, dataset=dataset, rig=tuple(space.camera(camera) for camera in self.rig))

    def statistics(self) -> Statistics | None:
        """Figures of live cameras; None for files, and while nothing is read."""
        return self.dataset.statistics() if isinstance(self.dataset, LiveDataset) else None

    def close(self) -> None:
        """Stop reading live cameras; may be called from any thread."""
        if isinstance(self.dataset, LiveDataset):
            self.dataset.close()


@dataclass(frozen=True, slots=True, eq=False)
class _Trained:
    """A trained state, to be encoded.

    Attributes:
        scene: the state.
        time_ns: its presentation time.
        change: the state before, and the residual from it; None where `scene` itself is to be sent.
        packet: of the change, where rate control had to know its size at once.
        refresh: a keyframe of the same instant, to be sent after the change, or None.
        preview, report, spans: as in `EncodedFrame`.
        captured: when the frame was filmed, in seconds of `time.perf_counter`; None for files.
    """

    scene: Scene
    time_ns: int
    report: dict[str, Any]
    change: tuple[Scene, Residual] | None = None
    refresh: Scene | None = None
    preview: bool = False
    spans: tuple[Span, ...] = ()
    captured: float | None = None
    packet: bytes | None = None

    def changing(self) -> bytes:
        """The packet of the change."""
        assert self.change is not None
        return encode_residual(*self.change, time_ns=self.time_ns)


def open_job(
    job: TrainJob, push_socket: Path | None = None, give_sound: Callable[[SoundPiece], None] | None = None
) -> OpenJob:
    """Open the data set and choose the cameras.

    Args:
        push_socket: where a live rig takes pictures that capture nodes push.
        give_sound: takes a live rig's sound as it comes, on threads of its own.

    Raises:
        InputError: the data set or the choice is unusable.
    """
    dataset: Dataset | LiveDataset
    if job.live is not None:
        dataset = open_live(job.live, downscale=job.downscale, push_socket=push_socket, give_sound=give_sound)
    elif job.data is not None:
        dataset = open_dataset(job.data, layout=job.layout, downscale=job.downscale)
    else:
        dataset = open_synthetic(synthetic_spec(job.synthetic or {}))
    names = training_cameras(dataset.names, job.train, job.views, job.test)
    dataset = dataset.normalised()
    chosen = dataset.select(names)
    if len(chosen.cameras) > MAX_CAMERAS:
        raise InputError(
            "--views", f"{len(chosen.cameras)} cameras are too many to train on; the most is {MAX_CAMERAS}"
        )
    # a scene's header has room for so many: of a larger rig, viewers are offered the places that trained
    rig = dataset.upright if len(dataset.cameras) <= MAX_CAMERAS else chosen.upright
    return OpenJob(job, chosen, rig)


def train_stream(
    opened: OpenJob,
    *,
    resume: Scene | None = None,
    start: int = 0,
    previews: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Generator[EncodedFrame, None, None]:
    """Train the job's frames in order on a thread, and encode each one while the next trains.

    A version counts published states; it equals the frame's index unless previews or a resumed state came before. An
    error of any stage is raised here, after the frames before it. A frame is given out when all its packets are made.

    Args:
        resume: continue from this keyframe, which has been published, instead of training one; `opened` has to be
            `continuing` from it.
        start: first frame to read.
        previews: also yield early keyframes while the first frame trains, for viewers that are waiting.
        on_progress: called on the training thread.
    """
    size = _KeyframeSize()

    def train(outlet: Outlet[_Trained]) -> None:
        _Training(opened, previews, on_progress, size, outlet).run(resume, start)

    # close the cameras first: training that waits for them could not be ended
    with closing(made_by(train, "training")) as trained, closing(opened):
        for state in trained:
            yield _encoded(state, size, opened.facts)


def train_clip(
    opened: OpenJob,
    out: Path,
    on_frame: Callable[[EncodedFrame], None],
    on_progress: Callable[[Progress], None] | None = None,
    sound: str = AUTO,
) -> None:
    """Train a clip into the file `out`, which appears when it is complete; figures go into `out`.json.

    The sound that `sound` names, as in `choose_sound`, goes into `out`.opus. A fault after the first frame, such as a
    damaged picture or a full disk, ends the files there, with all frames trained before.

    Raises:
        TrainingCutShort: such a fault, one that is foreseen; another one is raised as it is, with a note.
    """
    dataset = opened.dataset
    chosen = choose_sound(dataset, sound) if isinstance(dataset, Dataset) else None
    first_seconds, seconds, reports, faults = 0.0, [], [], list[Exception]()
    with SlodWriter(out) as writer, closing(train_stream(opened, on_progress=on_progress)) as frames:
        for encoded in _up_to_fault(frames, faults):
            begin = time.perf_counter()
            try:
                for packet in encoded.packets:
                    writer.append(packet)
            except OSError as error:
                faults.append(InputError(out, f"cannot be written ({error.strerror})"))
                break
            written = Span("write", "write", begin, time.perf_counter())
            reports.append(encoded.report)
            if encoded.version == 0:
                first_seconds = encoded.report["total_seconds"]
            else:
                seconds.append(encoded.report["total_seconds"])
            on_frame(replace(encoded, spans=(*encoded.spans, written)))
        if faults and not reports:
            raise faults[0]
    cut = TrainingCutShort(out, str(faults[0]), len(reports), opened.stop) if faults else None
    figures = {
        "train_seconds": float(np.mean(seconds)) if seconds else None,
        "first_frame_seconds": first_seconds,
        "space": opened.dataset.space.to_json(),
        "trained_cameras": list(dataset.names),
        "job": {name: str(value) for name, value in opened.job.to_json().items()},
        "cut_short": None if cut is None else str(cut),
        "per_frame": reports,
    }
    untold: tuple[type[Exception], ...] = (InputError, OSError) if cut else ()  # what came first is told
    with suppress(*untold):
        write_text(out.with_name(out.name + ".json"), json.dumps(figures, indent=1))
        if isinstance(dataset, Dataset):
            source = dataset.recording.source
            write_beside(out, chosen, source.time_ns(len(reports) - 1) / 1e9 + 1 / source.fps)
    if cut is not None:
        if isinstance(faults[0], StreamlodError | OSError):
            raise cut from faults[0]
        faults[0].add_note(str(cut))
        raise faults[0]


def _up_to_fault(frames: Iterator[EncodedFrame], faults: list[Exception]) -> Iterator[EncodedFrame]:
    """`frames` up to the first error, which is put into `faults`; those of the consumer are its own."""
    try:
        yield from frames
    except Exception as error:
        faults.append(error)


class _KeyframeSize:
    """Bytes of the newest keyframe's packet, which the encoding stage tells the training stage."""

    def __init__(self) -> None:
        self._newest = -1, 0  # version and bytes: one value, as two threads use it

    def note(self, keyframe: Scene, packet: bytes) -> bytes:
        """`packet`, which is the keyframe's."""
        self._newest = keyframe.version, len(packet)
        return packet

    def size_bytes(self, keyframe: Scene) -> int:
        """Bytes of the keyframe's packet, which is encoded once more where this process has not sent it."""
        version, size = self._newest
        return size if version == keyframe.version else keyframe_bytes(keyframe)


class _Training:
    """The training stage, which puts its states into `outlet`."""

    def __init__(
        self,
        opened: OpenJob,
        previews: bool,
        on_progress: Callable[[Progress], None] | None,
        size: _KeyframeSize,
        outlet: Outlet[_Trained],
    ) -> None:
        self._job, self._dataset, self._opened = opened.job, opened.dataset, opened
        self._previews, self._on_progress, self._outlet = previews, on_progress, outlet
        job, dataset = opened.job, opened.dataset
        self._config = replace(with_settings(preset(job.preset), job.set or {}), seed=job.seed)
        self._trainer = Trainer(
            dataset.cameras,
            self._config,
            dataset.fps,
            job.device,
            opened.rig,
            frame_budget_ms=job.frame_budget_ms,
            target_kbps=job.target_kbps,
        )
        self._refresh = RefreshSchedule(RefreshRule(max_age=job.keyframe_interval), size.size_bytes)
        self._first_contrast = 0.0  # of the pictures that the first frame was trained of

    def run(self, resume: Scene | None, start: int) -> None:
        """Train all frames from `start`, after the state to resume if there is one."""
        if self._job.frame_budget_ms is not None:
            rehearse(self._job.preset, self._job.device)  # so that the first frames spend no time on loading code
        shift = 0
        if resume is not None:
            self._trainer.resume(resume)
            self._first_contrast = contrast_of_scene(resume, self._dataset.cameras)
            shift = resume.version + 1 - start
        with closing(self._opened.frames(start, self._trainer.prepare)) as frames:
            for filmed, read in frames:
                captured = None if filmed.latency_ns is None else read.end - filmed.latency_ns / 1e9
                frame = replace(filmed, index=filmed.index + shift)
                if self._trainer.has_state and not self._begins_anew(frame):
                    trained = self._later(frame)
                else:
                    trained = self._first(frame)
                    shift = trained.scene.version - filmed.index
                self._outlet.put(replace(trained, spans=(read, *trained.spans), captured=captured))

    def _begins_anew(self, frame: FrameSet) -> bool:
        """Whether the first frame had too little in it, and this one has something; see `dark_start`."""
        if not is_dark(self._first_contrast) or not is_worth_anew(self._first_contrast, contrast(frame)):
            return False
        _LOG.info("version %d: trained anew, as there was next to nothing in the first pictures", frame.index)
        return True

    def _first(self, frame: FrameSet) -> _Trained:
        """The first keyframe, with previews before it if they are wanted: a draft, then the training's own."""
        dataset, version, due = self._dataset, frame.index, list(_PREVIEWS_AT)
        self._first_contrast = contrast(frame)

        def show(scene: Scene, fraction: float) -> None:
            nonlocal version
            scene = replace(scene, keyframe=version, version=version)
            self._outlet.put(_Trained(scene, frame.time_ns, {"fraction": fraction}, preview=True))
            version += 1

        def tell(progress: Progress) -> None:
            self._outlet.check()
            if self._on_progress is not None:
                self._on_progress(progress)

        def look_for_depth(done: float) -> None:
            tell(Progress("looking for depth", _POINTS_SHARE * done, 0.0, 0))

        def train(progress: Progress) -> None:
            fraction = _POINTS_SHARE + (1 - _POINTS_SHARE) * progress.fraction
            tell(replace(progress, fraction=fraction))
            if self._previews and progress.preview is not None and due and progress.fraction >= due[0]:
                due.pop(0)
                show(progress.preview(), fraction)

        tell(Progress("first look", 0.0, 0.0, 0))
        if self._previews and (draft := self._draft(frame)) is not None:
            show(draft, 0.0)
        points, found = timing(
            "train",
            lambda: first_points(
                frame,
                dataset.cameras,
                depth_bounds=dataset.depth_bounds,
                method=self._job.points,
                dataset_points=dataset.points(),
                seed=self._job.seed,
                progress=look_for_depth,
                space=dataset.space,
            ),
        )
        trained = self._trainer.keyframe(frame, points, train)
        scene = trained.scene
        if version != frame.index:
            scene = replace(scene, keyframe=version, version=version)
            self._trainer.resume(scene, keep_references=True)
        spans = (replace(found, name="points"), *_spans(trained))
        return _Trained(scene, frame.time_ns, _report(trained, spans, version), spans=spans)

    def _draft(self, frame: FrameSet) -> Scene | None:
        """A first picture; None where the cameras cannot give one so fast."""
        dataset = self._dataset
        try:
            return draft_scene(
                frame,
                dataset.cameras,
                self._config,
                dataset.fps,
                self._job.device,
                self._opened.rig,
                dataset.depth_bounds,
                dataset.points(),
            )
        except (InputError, ModelError) as error:
            _LOG.info("no draft of the first picture: %s", error)
            return None

    def _report_refresh(self, progress: Progress) -> None:
        self._outlet.check()
        _LOG.debug("keyframe: %.0f %% of its training done", 100 * progress.fraction)

    def _later(self, frame: FrameSet) -> _Trained:
        """One later frame: its residual, and from time to time a refresh keyframe of the same instant after it."""
        before = self._trainer.scene
        trained = self._trainer.predict(frame)
        assert trained.residual is not None
        scene, refresh, spans = trained.scene, None, _spans(trained)
        if self._refresh.due(before, scene) is not None:
            _LOG.info("version %d: a refresh keyframe", scene.version)
            keyframe = self._trainer.refresh(frame, self._report_refresh)
            refresh, spans = keyframe.scene, (*spans, *_spans(keyframe))
        report = _report(trained, spans, scene.version)
        state = _Trained(scene, frame.time_ns, report, (before, trained.residual), refresh, spans=spans)
        if self._job.target_kbps is None:
            return state
        packet, span = timing("encode", state.changing)
        self._trainer.sent(trained, len(packet), span.end - span.begin)
        return replace(state, packet=packet)


def _announced(frames: Iterator[FrameSet], *listeners: Callable[[FrameSet], None]) -> Generator[FrameSet, None, None]:
    for frame in frames:
        for listener in listeners:
            listener(frame)
        yield frame


def _encoded(state: _Trained, size: _KeyframeSize, facts: Metadata) -> EncodedFrame:
    """All packets of a state, keyframes with `facts`, and the time that encoding took in its report."""

    def keyframe(scene: Scene) -> bytes:
        told = replace(scene, metadata=replace(scene.metadata, title=facts.title, licence=facts.licence))
        return size.note(scene, encode_keyframe(told, time_ns=state.time_ns))

    def encode() -> Iterator[bytes]:
        if state.change is None:
            yield keyframe(state.scene)
        else:
            yield state.packet or state.changing()
        if state.refresh is not None:
            yield keyframe(state.refresh)

    packets, span = timing("encode", lambda: tuple(encode()))
    report, seconds = state.report, span.end - span.begin
    if not state.preview:
        report = {**report, "seconds": {**report["seconds"], "encode": seconds}}
        report["total_seconds"] += seconds
    if state.captured is not None:
        report = {**report, "latency_seconds": span.end - state.captured}
    return EncodedFrame(state.scene.version, packets, report, state.preview, (*state.spans, span))


def _spans(trained: TrainedFrame) -> tuple[Span, ...]:
    return tuple(Span("train", *span) for span in trained.report.spans)


def _report(trained: TrainedFrame, spans: tuple[Span, ...], version: int) -> dict[str, Any]:
    """Figures of `trained`, with the seconds of all stages in `spans`."""
    seconds: dict[str, float] = {}
    for span in spans:
        seconds[span.name] = seconds.get(span.name, 0.0) + span.end - span.begin
    figures = asdict(replace(trained.report, spans=()))
    del figures["spans"]
    return {**figures, "seconds": seconds, "total_seconds": sum(seconds.values()), "version": version}
