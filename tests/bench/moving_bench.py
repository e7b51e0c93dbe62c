"""Quality of what moves, over the frames of a synthetic clip, and what it depends on.

    python -m tests.bench.moving_bench [--kind hard --speed 4 --frames 32 --size 200x112 --views 6]
        [--run predict.epochs=5,...] [--device cuda]

Every `--run` is a run of its own with these settings changed (`core.train.presets.settings`); all start from the same
first frame. Four causes of decay can be switched off beside them: `truth=1` trains exactly the anchors that show what
moves or has just moved, `finer=10` makes the steps of residuals so many times finer without a price on bits, `renew=10`
trains a refresh keyframe of the state every so many frames, and `anew=20` a first frame.

Each run tells PSNR on moving pixels (true motion, dilated; docs/history/benchmarks.md) of the held-out camera and of
the training cameras, as means over frames 3 to 10, over the middle and over the last 10; the mean PSNR of the whole
held-out picture; bytes and seconds a frame (of the CPU; wall time on a GPU); and how many anchors mostly show what
moves, at the same times; steps and seconds of each stage.
`--json FILE` keeps the figures of every frame, and `--against FILE` compares with such figures, of other settings or of
another version of the program. `--pictures FILE.jpg --at 3 20 40` draws the held-out camera at these
frames, side by side: the truth above, for each run a row below.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from streamlod.client.evaluation.measure.moving import MovingPixels
from streamlod.client.evaluation.measure.scores import draw
from streamlod.client.evaluation.measure.truth import shown_motion
from streamlod.client.evaluation.systems import with_coarser_steps, with_steps
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.arrays import Bool, UInt8
from streamlod.core.camera import Camera
from streamlod.core.data import linspace_split
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.motion import cues
from streamlod.core.train.motion.scores import Observation
from streamlod.core.train.presets.settings import with_settings
from streamlod.server.cli.options import fields_in

_HELD_OUT = "cam00"
_FIGURES = ("moving", "fitted", "whole", "size", "seconds", "trained", "steps", "stages", "anchors")  # of a `Course`
_EARLY, _LATE = slice(3, 11), slice(-10, None)  # frames
_COUNTED_EVERY = 4  # frames between counts of the anchors that show what moves
_CAUSES = {"truth", "finer", "renew", "anew"}
_SHOWN = 0.05  # pixels of what moves, from which an anchor belongs to the true set


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A synthetic clip: training pictures and those of the camera that is held out."""

    spec: SyntheticSpec
    fps: float
    cameras: tuple[Camera, ...]
    held_out: Camera
    training: list[FrameSet]
    testing: list[FrameSet]
    bounds: tuple[float, float]


@dataclass(slots=True)
class Course:
    """Figures of one run, a frame each: dB on movers (held out, trained), dB of the picture, bytes, seconds."""

    moving: list[float] = field(default_factory=list)
    fitted: list[float] = field(default_factory=list)
    whole: list[float] = field(default_factory=list)
    size: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    trained: list[int] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    anchors: dict[int, int] = field(default_factory=dict)
    pictures: dict[int, UInt8] = field(default_factory=dict)

    def told(self) -> str:
        """One line."""
        spans = (_EARLY, slice(len(self.moving) // 2 - 5, len(self.moving) // 2 + 5), _LATE)
        early, middle, late = ([np.nanmean(values[span]) for values in (self.moving, self.fitted)] for span in spans)
        counts = list(self.anchors.values())
        return (
            f"moving {early[0]:.2f} {middle[0]:.2f} {late[0]:.2f} (trained {early[1]:.2f} {middle[1]:.2f} "
            f"{late[1]:.2f}), picture {np.mean(self.whole[1:]):.2f} dB, {np.mean(self.size):.0f} bytes, "
            f"{np.mean(self.seconds):.3f} s, {np.mean(self.trained):.0f} trained, "
            f"movers' anchors {counts[0]} {counts[len(counts) // 2]} {counts[-1]}; {np.mean(self.steps):.0f} steps, "
            + ", ".join(f"{stage} {seconds / len(self.size):.3f} s" for stage, seconds in self.stages.items())
        )

    def against(self, other: dict[str, Any]) -> str:
        """One line: this run beside the figures of another one, over all frames but the first."""
        frames = slice(1, len(self.whole))
        moving, whole = (
            np.nanmean(mine[frames]) - np.nanmean(theirs[frames])
            for mine, theirs in ((self.moving, other["moving"]), (self.whole, other["whole"]))
        )
        seconds, size = (np.sum(mine) / np.sum(theirs) for mine, theirs in (
            (self.seconds, other["seconds"]), (self.size, other["size"])
        ))  # fmt: skip
        return f"moving {moving:+.2f} dB, picture {whole:+.2f} dB, bytes x{size:.3f}, seconds x{seconds:.2f}"


def open_clip(spec: SyntheticSpec, views: int) -> Clip:
    """Render it."""
    whole = open_synthetic(spec)
    training = whole.select(linspace_split(whole.names, views, (_HELD_OUT,)).train)
    testing = whole.select((_HELD_OUT,))
    assert whole.depth_bounds is not None
    return Clip(
        spec, whole.fps, training.cameras, testing.cameras[0], list(training.frames()), list(testing.frames()),
        whole.depth_bounds,
    )  # fmt: skip


class TrueSet:
    """A motion cue that knows: anchors that show what moves in this frame or did in the one before."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self.before, self.index = None, 0

    def partition(self, seen: Observation, posterior: float) -> Bool:
        """As `MotionCue.partition`."""
        assert self.before is not None
        shown = np.zeros(len(seen.field))
        for index in {max(self.index - 1, 1), self.index}:
            shown = np.maximum(shown, shown_motion(self._clip.spec, self.before, index, self._clip.cameras)[1])
        return np.asarray((shown >= _SHOWN) & seen.alive.cpu().numpy())


def first_frame(clip: Clip, config: TrainConfig, kept: Path | None, device: str) -> Scene:
    """The first frame, from the packet `kept` if there is one."""
    if kept is not None and kept.is_file():
        decoder = SceneDecoder()
        decoder.push(kept.read_bytes())
        assert decoder.scene is not None
        return decoder.scene
    points = first_points(clip.training[0], clip.cameras, depth_bounds=clip.bounds)
    scene = Trainer(clip.cameras, config, clip.fps, device).keyframe(clip.training[0], points).scene
    if kept is not None:
        kept.write_bytes(encode_keyframe(scene, time_ns=0))
    return scene


def follow(
    clip: Clip, config: TrainConfig, first: Scene, causes: dict[str, int], kept: list[int], device: str
) -> Course:
    """Train all frames after the first and measure them; the pictures of frames `kept` stay."""
    truth = TrueSet(clip)
    if causes.get("truth"):
        cues.CUES["truth"] = cues.MotionCue(truth.partition, only_changed_views=True)
        config = replace(config, predict=replace(config.predict, cue="truth"))
    course = Course()
    held, fitted = MovingPixels((clip.held_out,), clip.spec), MovingPixels(clip.cameras, clip.spec)
    clock = time.process_time if device == "cpu" else time.perf_counter
    trainer = Trainer(clip.cameras, config, clip.fps, device, clock=clock)
    truth.before = first
    trainer.resume(first)
    trainer.predict(clip.training[0])  # tells the trainer what the first frame was shown
    trainer.resume(first, keep_references=True)
    for frame, test in zip(clip.training, clip.testing, strict=True):
        if frame.index:
            before = truth.before = trainer.scene
            truth.index = frame.index
            begin = clock()
            result = trainer.predict(frame)
            assert result.residual is not None
            course.size.append(len(encode_residual(before, result.residual, time_ns=0)))
            course.seconds.append(clock() - begin)
            course.trained.append(result.report.dynamic)
            course.steps.append(result.report.steps)
            for stage, seconds in result.report.seconds.items():
                course.stages[stage] = course.stages.get(stage, 0.0) + seconds
        scene = trainer.scene
        drawn = draw(scene, clip.held_out)
        course.whole.append(psnr(drawn, test.images[0]))
        if frame.index in kept:
            course.pictures[frame.index] = drawn
        course.moving.append(_moving_psnr([drawn], test, held))
        course.fitted.append(np.nan)
        if frame.index and frame.index % _COUNTED_EVERY == 0:
            course.fitted[-1] = _moving_psnr([draw(scene, camera) for camera in clip.cameras], frame, fitted)
            seen, _, visibly = shown_motion(clip.spec, scene, frame.index, clip.cameras)
            course.anchors[frame.index] = int(((seen >= 0.3) & (visibly >= 0.5 * seen)).sum())
        if frame.index and causes.get("renew") and frame.index % causes["renew"] == 0:
            trainer.refresh(frame)
        if frame.index and causes.get("anew") and frame.index % causes["anew"] == 0:
            points = first_points(frame, clip.cameras, depth_bounds=clip.bounds)
            trainer.keyframe(frame, points)
    return course


def _moving_psnr(drawn: list[UInt8], truth: FrameSet, pixels: MovingPixels) -> float:
    masks = pixels.masks(max(truth.index, 1), truth.images)
    assert masks is not None
    found = [
        psnr(one[mask][None], true[mask][None])
        for one, true, mask in zip(drawn, truth.images, masks, strict=True)
        if mask.any()
    ]
    return float(np.mean(found)) if found else np.nan


def changed(config: TrainConfig, changes: str) -> tuple[TrainConfig, dict[str, int]]:
    """`config` with comma-separated changes of its settings, and the causes that are switched off."""
    found = fields_in(changes)
    causes = {name: int(found.pop(name)) for name in _CAUSES & found.keys()}
    config = with_settings(config, found)
    if "finer" in causes:
        config = with_coarser_steps(config, 1 / causes["finer"])
        config = replace(config, predict=replace(config.predict, rate_weight=0.0))
    return config, causes


def main() -> None:
    options = _options()
    width, height = map(int, options.size.split("x"))
    spec = SyntheticSpec(
        kind=options.kind, frames=options.frames, width=width, height=height, seed=options.clip_seed,
        speed=options.speed, cameras=options.cameras,
    )  # fmt: skip
    clip = open_clip(spec, options.views)
    base = replace(preset(options.preset), seed=options.seed)
    first = first_frame(clip, base, options.first, options.device)
    rows = [[clip.testing[index].images[0] for index in options.at]]
    for changes in options.run or [""]:
        config, causes = changed(base, changes)
        course = follow(
            clip, config, with_steps(first, base.predict, config.predict), causes, options.at, options.device
        )
        rows.append([course.pictures[index] for index in options.at])
        print(f"{changes or options.preset:32s} {course.told()}", flush=True)
        if options.against:
            known = [json.loads(line) for line in options.against.read_text().splitlines()]
            for other in known:
                print(f"{'against ' + (other['run'] or options.preset):32s} {course.against(other)}", flush=True)
        if options.json:
            with options.json.open("a") as file:
                file.write(json.dumps({"run": changes, **{n: getattr(course, n) for n in _FIGURES}}) + "\n")
    if options.pictures:
        sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows], axis=0)
        cv2.imwrite(str(options.pictures), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", default="hard")
    parser.add_argument("--speed", type=float, default=4.0, help="pixels a frame of the fastest thing")
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--size", default="200x112")
    parser.add_argument("--cameras", type=int, default=13)
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--preset", default="live")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--clip-seed", type=int, default=0)
    parser.add_argument("--first", type=Path, help="packet of the first frame, written where it is absent")
    parser.add_argument("--json", type=Path, help="append the figures of every frame")
    parser.add_argument("--against", type=Path, help="figures that --json kept, of the same clip and first frame")
    parser.add_argument("--pictures", type=Path, help="JPEG of the frames of --at")
    parser.add_argument("--at", type=int, nargs="+", default=[], help="frames to draw")
    parser.add_argument("--run", action="append", metavar="PART.NAME=VALUE,...")
    return parser.parse_args()


if __name__ == "__main__":
    main()
