"""Later frames of a recording where viewers stand: at the cameras that train, and at those that are held out.

    python -m tests.bench.rig_bench DATA [--downscale 2 --begin 0 --frames 16 --stride 1 --test cam00 --seed 0]
        [--run predict.epochs=5,...] [--first FILE] [--out DIR [--at 10 30 50]]
        [--total 1000 [--keyframes 100]]

Every `--run` is a run of its own with these settings changed (`core.train.presets.settings`); all start from the same
first frame, which `--first` keeps as a packet. Each run tells, as means over the later frames: PSNR at each camera that
trains, at its best exposure; of the held-out pictures; and of pixels that differ from the first picture, there and
there; bytes and CPU seconds a frame, and seconds of each stage. `--out` saves the last frame, or the later frames
`--at`, beside the truth, and says which of them are worst.

`--total` goes on for so many later frames, back and forth through the instants, and also tells the means of each
hundred of them, with the peak of the memory, so that drift shows; `--keyframes` sends some as a stream does, at the
latest after so many frames, with their bytes and seconds among those of their frame.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from streamlod.client.evaluation.measure.memory import forget_peak, peak_bytes
from streamlod.client.evaluation.measure.scores import draw, fitted_psnr
from streamlod.client.evaluation.report.output import result_folder, side_by_side
from streamlod.client.recorder import write_png
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.refresh import RefreshRule, RefreshSchedule
from streamlod.core.arrays import Bool, UInt8
from streamlod.core.camera import Camera
from streamlod.core.data import linspace_split, open_dataset
from streamlod.core.frames import FrameSet, PointCloud
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.presets.settings import with_settings
from streamlod.server.cli.options import fields_in

_DIFFERENT = 10  # grey levels, of pictures blurred over five pixels
_SPREAD = np.ones((5, 5), np.uint8)
_PART = 100  # later frames of which means are told


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """Some instants of a recording: cameras that train and their pictures, and likewise those that are held out."""

    cameras: tuple[Camera, ...]
    training: list[FrameSet]
    held_out: tuple[Camera, ...]
    testing: list[FrameSet]
    points: PointCloud | None
    bounds: tuple[float, float] | None
    fps: float


@dataclass(frozen=True, slots=True)
class Course:
    """Figures of one run, a later frame each: dB at the cameras, held out, and of changed pixels; bytes, seconds.

    `keyframes` are numbers of the frames that one was sent after.
    """

    at: list[list[float]] = field(default_factory=list)
    beside: list[list[float]] = field(default_factory=list)
    moving_at: list[float] = field(default_factory=list)
    moving_beside: list[float] = field(default_factory=list)
    size: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    stages: Counter[str] = field(default_factory=Counter)
    keyframes: list[int] = field(default_factory=list)

    def of_latest(self, count: int) -> str:
        """Means of the latest `count` frames."""
        at, moving = np.mean(self.at[-count:]), np.nanmean(self.moving_at[-count:])
        text = f"to frame {len(self.size)}: at {at:.2f} dB, changed {moving:.2f}"
        if self.beside:
            text += f", held out {np.mean(self.beside[-count:]):.2f}"
        sent = sum(number > len(self.size) - count for number in self.keyframes)
        size, seconds = np.mean(self.size[-count:]), np.mean(self.seconds[-count:])
        return text + f", {size:.0f} bytes, {sent} keyframes, {seconds:.2f} CPU s"

    def told(self) -> str:
        """One line."""
        at = np.array(self.at)
        text = (
            f"at {' '.join(f'{value:.2f}' for value in at.mean(axis=0))} = {at.mean():.2f} dB, last {at[-1].mean():.2f}"
        )
        if self.beside:
            text += f", held out {np.mean(self.beside):.2f}"
        text += f"; changed {np.nanmean(self.moving_at):.2f}"
        if self.beside:
            text += f", held out {np.nanmean(self.moving_beside):.2f}"
        stages = ", ".join(f"{name} {seconds / len(self.size):.2f}" for name, seconds in self.stages.most_common())
        return f"{text}; {np.mean(self.size):.0f} bytes, {np.mean(self.seconds):.2f} CPU s ({stages} s)"


def opened(options: argparse.Namespace) -> Subject:
    """The instants that the options name."""
    dataset = open_dataset(options.data, downscale=options.downscale)
    names, test = list(dataset.names), tuple(options.test)
    rows = [names.index(name) for name in linspace_split(names, options.views, test).train]
    others = [names.index(name) for name in test]
    stop = options.begin + options.frames * options.stride + 1
    frames = [
        frame for frame in dataset.frames(options.begin, stop) if not (frame.index - options.begin) % options.stride
    ]

    def of(chosen: list[int]) -> list[FrameSet]:
        return [FrameSet(f.index, f.time_ns, f.images[chosen], f.present[chosen]) for f in frames]

    if options.total:
        frames = _back_and_forth(frames, options.total + 1)
    cameras = [tuple(dataset.cameras[row] for row in chosen) for chosen in (rows, others)]
    points, bounds = dataset.points(), dataset.depth_bounds
    return Subject(cameras[0], of(rows), cameras[1], of(others), points, bounds, dataset.fps)


def _back_and_forth(frames: list[FrameSet], count: int) -> list[FrameSet]:
    """`count` instants as though the recording ran forward and backward in turn, its numbers and times going on."""
    interval, turn = frames[1].time_ns - frames[0].time_ns, len(frames) - 1
    rows = [turn - abs(turn - number % (2 * turn)) for number in range(count)]
    begin = frames[0]
    return [
        replace(frames[row], index=begin.index + number, time_ns=begin.time_ns + number * interval)
        for number, row in enumerate(rows)
    ]


def first_scene(subject: Subject, config: TrainConfig, kept: Path | None) -> Scene:
    """The first frame, from the packet `kept` if there is one."""
    if kept is not None and kept.is_file():
        decoder = SceneDecoder()
        decoder.push(kept.read_bytes())
        assert decoder.scene is not None
        return decoder.scene
    frame = subject.training[0]
    points = first_points(frame, subject.cameras, depth_bounds=subject.bounds, dataset_points=subject.points)
    scene = Trainer(subject.cameras, config, subject.fps, "cpu").keyframe(frame, points).scene
    if kept is not None:
        kept.write_bytes(encode_keyframe(scene, time_ns=0))
    return scene


def follow(
    subject: Subject, config: TrainConfig, first: Scene, keyframes: int | None = None, at: Collection[int] = ()
) -> tuple[Course, dict[int, Scene]]:
    """Train all frames after the first and measure them; also the states after the frames `at`, counted from 1."""
    course, scenes = Course(), dict[int, Scene]()
    trainer = Trainer(subject.cameras, config, subject.fps, "cpu", clock=time.process_time)
    schedule = None if keyframes is None else RefreshSchedule(RefreshRule(max_age=keyframes))
    trainer.resume(first)
    trainer.predict(subject.training[0])  # tells the trainer what the first frame was shown
    trainer.resume(first, keep_references=True)
    for number, (frame, test) in enumerate(zip(subject.training[1:], subject.testing[1:], strict=True), 1):
        before, begin = trainer.scene, time.process_time()
        result = trainer.predict(frame)
        course.stages.update(result.report.seconds)
        assert result.residual is not None
        size_bytes = len(encode_residual(before, result.residual, time_ns=frame.time_ns))
        if schedule is not None and schedule.due(before, result.scene) is not None:
            course.keyframes.append(number)
            size_bytes += len(encode_keyframe(trainer.refresh(frame).scene, time_ns=frame.time_ns))
        course.size.append(size_bytes)
        course.seconds.append(time.process_time() - begin)
        if number in at:
            scenes[number] = result.scene
        drawn = [draw(result.scene, camera) for camera in subject.cameras]
        course.at.append([fitted_psnr(one, true) for one, true in zip(drawn, frame.images, strict=True)])
        course.moving_at.append(_of_changed(drawn, frame, subject.training[0]))
        if subject.held_out:
            drawn = [draw(result.scene, camera) for camera in subject.held_out]
            course.beside.append([psnr(one, true) for one, true in zip(drawn, test.images, strict=True)])
            course.moving_beside.append(_of_changed(drawn, test, subject.testing[0]))
        if number % _PART == 0:
            print(f"  {course.of_latest(_PART)}, {peak_bytes() / 1e6:.0f} MB at most", flush=True)
            forget_peak()
    return course, scenes


def _of_changed(drawn: list[UInt8], now: FrameSet, first: FrameSet) -> float:
    """dB of all pixels that differ from the first pictures."""
    masks = [_differs(one, other) for one, other in zip(now.images, first.images, strict=True)]
    pairs = [(one[mask], true[mask]) for one, true, mask in zip(drawn, now.images, masks, strict=True)]
    shown, true = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return psnr(shown[None], true[None]) if len(true) else np.nan


def _differs(picture: UInt8, other: UInt8) -> Bool:
    """[H,W] bool."""
    now, before = (cv2.blur(one.astype(np.float32), _SPREAD.shape) for one in (picture, other))
    return np.asarray(cv2.dilate((np.abs(now - before).max(axis=2) > _DIFFERENT).astype(np.uint8), _SPREAD) > 0)


def main() -> None:
    options = _options()
    subject = opened(options)
    base = replace(preset(options.preset), seed=options.seed)
    first = first_scene(subject, base, options.first)
    print(f"first frame: {first.anchor_count} anchors, {len(encode_keyframe(first, time_ns=0)) / 1000:.0f} kB")
    shortest = replace(subject, training=subject.training[:2], testing=subject.testing[:2])
    follow(shortest, base, first)  # compiling is not timed
    for changes in options.run or [""]:
        config, at = with_settings(base, fields_in(changes)), options.at or [len(subject.training) - 1]
        course, scenes = follow(subject, config, first, options.keyframes, at)
        print(f"{changes or options.preset}: {course.told()}", flush=True)
        if options.out is not None:
            save(subject, scenes, result_folder(options.out / (changes or options.preset)))


def save(subject: Subject, scenes: dict[int, Scene], folder: Path) -> None:
    """Pictures of later frames, truth on the left; prints their names, worst first."""
    cameras, found = (*subject.cameras, *subject.held_out), list[tuple[float, str]]()
    for number, scene in scenes.items():
        truths = (*subject.training[number].images, *subject.testing[number].images)
        for camera, truth in zip(cameras, truths, strict=True):
            shown, name = draw(scene, camera), f"{number:03d}-{camera.name}.png"
            found.append((fitted_psnr(shown, truth), name))
            write_png(folder / name, side_by_side(truth, shown))
    print("\n".join(f"  {quality:.2f} dB {name}" for quality, name in sorted(found)), flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--downscale", type=float, default=1)
    parser.add_argument("--begin", type=int, default=0, help="first frame")
    parser.add_argument("--frames", type=int, default=16, help="later frames")
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--preset", default="live")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--total", type=int, help="later frames, back and forth through those of --frames")
    parser.add_argument("--keyframes", type=int, help="most later frames before one is sent")
    parser.add_argument("--views", type=int)
    parser.add_argument("--test", nargs="*", default=[], help="cameras that are held out")
    parser.add_argument("--first", type=Path, help="packet of the first frame, written where it is absent")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--at", type=int, nargs="+", help="later frames to save, counted from 1")
    parser.add_argument("--run", action="append", metavar="PART.NAME=VALUE,...")
    return parser.parse_args()


if __name__ == "__main__":
    main()
