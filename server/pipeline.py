"""From pictures to packets: a data set, the trainer and the codec, composed.

`train_stream` is what the worker process runs live; `train_clip` writes a whole clip into a file.
"""

from __future__ import annotations

import json
import queue
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from codec.container import SlodWriter
from codec.encoder import encode_keyframe, encode_residual
from codec.packet import PacketKind
from core.anchors import Scene
from core.camera import Camera
from core.data import Dataset, linspace_split, open_dataset, prefetch
from core.data.synthetic import SyntheticSpec, open_synthetic
from core.frames import FrameSet
from core.initialise import first_points
from core.rekey import rekey
from core.train import Progress, TrainedFrame, Trainer, preset

_PREFETCHED = 2  # frames decoded ahead
_PREVIEWS_AT = (0.1, 0.3, 0.6, 2.0)  # of the first frame's run; the last is never reached


@dataclass(frozen=True, slots=True)
class TrainJob:
    """What to train, and how.

    Attributes:
        data: a data set's folder, or None for the synthetic clip.
        synthetic: the clip to make where `data` is None.
        layout: of the folder, or None to detect it.
        train, test: names of cameras; where `train` is empty, `views` of the rest are chosen by the linspace rule.
        frames: at most so many, or None for all.
        downscale: factor by which pictures are made smaller.
        preset, device, seed: of the trainer.
        points: where first points come from, see `core.initialise.first_points`.
        keyframe_interval: frames between keyframes.
    """

    data: Path | None = None
    synthetic: SyntheticSpec | None = None
    layout: str | None = None
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    views: int | None = None
    frames: int | None = None
    downscale: float = 1.0
    preset: str = "balanced"
    device: str = "auto"
    seed: int = 0
    points: str = "auto"
    keyframe_interval: int = 300


@dataclass(frozen=True, slots=True)
class EncodedFrame:
    """One frame's packets with the figures of its training.

    Attributes:
        version: frame index.
        packets: one, or two where a new keyframe follows the frame's residual.
        report: JSON-able figures.
        preview: whether the packet is an early, unfinished keyframe.
    """

    version: int
    packets: tuple[bytes, ...]
    report: dict[str, Any]
    preview: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class OpenJob:
    """A job's data set, reduced to the cameras it trains on, and the whole rig."""

    dataset: Dataset
    rig: tuple[Camera, ...]


def open_job(job: TrainJob) -> OpenJob:
    """Open the data set and choose the cameras.

    Raises:
        InputError: the data set or the choice is unusable.
    """
    if job.data is None:
        dataset: Dataset = open_synthetic(job.synthetic or SyntheticSpec())
    else:
        dataset = open_dataset(job.data, layout=job.layout, downscale=job.downscale)
    names = job.train or linspace_split(dataset.names, job.views, job.test).train
    return OpenJob(dataset.select(names), dataset.cameras)


def train_stream(
    job: TrainJob,
    *,
    resume: Scene | None = None,
    start: int = 0,
    previews: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Iterator[EncodedFrame]:
    """Train the job's frames in order and encode them.

    Versions count published states: frame numbers, unless previews or a resumed state came before.

    Args:
        resume: go on from this state with a fresh keyframe instead of training one.
        start: first frame to read.
        previews: also yield early keyframes while the first frame trains, for viewers who wait.
    """
    opened = open_job(job)
    dataset = opened.dataset
    trainer = Trainer(dataset.cameras, preset(job.preset), dataset.fps, job.device, opened.rig)
    shift = 0 if resume is None else resume.version + 1 - start
    stop = dataset.frame_count if job.frames is None else min(job.frames, dataset.frame_count)
    with closing(prefetch(dataset.frames(start, stop), _PREFETCHED)) as frames:
        for filmed in frames:
            frame = replace(filmed, index=filmed.index + shift)
            if trainer.has_state:
                yield from _predicted(trainer, frame, job.keyframe_interval)
            elif resume is not None:
                scene = rekey(resume, frame.index)
                trainer.resume(scene)
                yield EncodedFrame(frame.index, (encode_keyframe(scene, time_ns=frame.time_ns),), {"resumed": True})
            else:
                for encoded in _first(trainer, frame, dataset, job, previews, on_progress):
                    shift = encoded.version - filmed.index
                    yield encoded


def train_clip(job: TrainJob, out: Path, on_frame: Callable[[EncodedFrame], None], **options: Any) -> None:
    """Train a clip into the file `out`, which appears when it is complete; figures go beside it into `out`.json."""
    first_seconds, seconds, reports = 0.0, [], []
    with SlodWriter(out) as writer:
        for encoded in train_stream(job, **options):
            for packet in encoded.packets:
                writer.append(packet)
            reports.append(encoded.report)
            if encoded.version == 0:
                first_seconds = encoded.report["total_seconds"]
            else:
                seconds.append(encoded.report["total_seconds"])
            on_frame(encoded)
    figures = {
        "train_seconds": float(np.mean(seconds)) if seconds else None,
        "first_frame_seconds": first_seconds,
        "job": {name: str(value) for name, value in asdict(job).items()},
        "per_frame": reports,
    }
    sidecar = out.with_name(out.name + ".json")
    temporary = sidecar.with_name(sidecar.name + ".part")
    temporary.write_text(json.dumps(figures, indent=1))
    temporary.replace(sidecar)


def _first(
    trainer: Trainer,
    frame: FrameSet,
    dataset: Dataset,
    job: TrainJob,
    previews: bool,
    on_progress: Callable[[Progress], None] | None,
) -> Iterator[EncodedFrame]:
    """The first keyframe, with early ones before it where viewers wait for them.

    The trainer calls back while it runs; a thread lets this generator hand previews on in the meantime.
    """
    begin = time.perf_counter()
    points = first_points(
        frame,
        dataset.cameras,
        depth_bounds=dataset.depth_bounds,
        method=job.points,
        dataset_points=dataset.points(),
        seed=job.seed,
    )
    point_seconds = time.perf_counter() - begin
    waiting: queue.SimpleQueue[EncodedFrame | None] = queue.SimpleQueue()
    version = frame.index

    def tell(progress: Progress) -> None:
        nonlocal version
        if on_progress is not None:
            on_progress(progress)
        if previews and progress.preview is not None and progress.fraction >= _PREVIEWS_AT[version - frame.index]:
            scene = replace(progress.preview(), keyframe=version, version=version)
            packet = encode_keyframe(scene, time_ns=frame.time_ns)
            waiting.put(EncodedFrame(version, (packet,), {"fraction": progress.fraction}, preview=True))
            version += 1

    def run() -> TrainedFrame:
        try:
            return trainer.keyframe(frame, points, tell)
        finally:
            waiting.put(None)

    with ThreadPoolExecutor(1, thread_name_prefix="first-frame") as pool:
        future: Future[TrainedFrame] = pool.submit(run)
        yield from iter(waiting.get, None)
        trained = future.result()
    scene = trained.scene
    if version != frame.index:
        scene = replace(scene, keyframe=version, version=version)
        trainer.resume(scene, keep_references=True)
    report = _report(trained, points=point_seconds)
    yield EncodedFrame(version, (encode_keyframe(scene, time_ns=frame.time_ns),), report)


def _predicted(trainer: Trainer, frame: FrameSet, keyframe_interval: int) -> Iterator[EncodedFrame]:
    """One later frame: its residual, and now and then a keyframe of the same instant after it."""
    before = trainer.scene
    trained = trainer.predict(frame)
    assert trained.residual is not None
    begin = time.perf_counter()
    packets = [encode_residual(before, trained.residual, kind=PacketKind.PREDICTED, time_ns=frame.time_ns)]
    if trained.scene.version - trained.scene.keyframe >= keyframe_interval:
        scene = rekey(trained.scene, trained.scene.version)
        trainer.resume(scene, keep_references=True)
        packets.append(encode_keyframe(scene, time_ns=frame.time_ns))
    report = _report(trained, encode=time.perf_counter() - begin)
    yield EncodedFrame(trained.scene.version, tuple(packets), report)


def _report(trained: TrainedFrame, **seconds: float) -> dict[str, Any]:
    """The figures of `trained`, with `seconds` of further stages."""
    stages = {**trained.report.seconds, **seconds}
    figures = asdict(trained.report)
    return {**figures, "seconds": stages, "total_seconds": sum(stages.values()), "version": trained.scene.version}
