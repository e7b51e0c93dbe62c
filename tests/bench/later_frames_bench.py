"""Later frames of the synthetic clip: quality over time, bytes, CPU time, and the dynamic set against true motion.

    python -m tests.bench.later_frames_bench [--frames 16 --views 5 --steps 500] [--set posterior=0.8 ...]

Every `--set` is a run of its own, with that field of `PredictConfig` changed, or several between commas; all start from
the same first frame. Each tells the held-out PSNR of every tenth frame, its mean over all but the first, its slope a
hundred frames, bytes of predicted packets and of a whole stream with its keyframes, and recall and precision of the
dynamic set. Keyframes come as the service sends them; `--interval` and `--refresh-steps` say when, and how they train.
`--errors` prints where the squared error of the held-out camera lies (1e-5 of the whole picture's): on what moves, on
what movers have left since the beginning, on what else looks different from the first picture, and elsewhere, beside
what the same pixels had at the first frame.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from streamlod.client.evaluation.measure.truth import dynamic_precision_recall
from streamlod.client.evaluation.systems import with_steps
from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.codec.refresh import RefreshRule, RefreshSchedule
from streamlod.core.arrays import Float32, UInt8
from streamlod.core.camera import Camera
from streamlod.core.data import linspace_split
from streamlod.core.frames import FrameSet
from streamlod.core.initialise import first_points
from streamlod.core.metrics import psnr
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.synthetic import SyntheticSpec, open_synthetic, surface_motion
from streamlod.core.train import PredictConfig, Trainer, preset

MOTION_EVERY, SHOWN_EVERY = 4, 10  # frames
_DIFFERENT = 0.04  # of [0, 1]: what looks different from the first picture


class Keyframes:
    """Sends keyframes when the service would; their `sizes` in bytes and CPU `seconds`."""

    def __init__(self, interval: int) -> None:
        self._refresh = RefreshSchedule(RefreshRule(max_age=interval))
        self.sizes, self.seconds = list[int](), 0.0

    def follow(self, trainer: Trainer, before: Scene, frame: FrameSet) -> None:
        """Count the refresh keyframe after `frame`, which led on from the state `before`, if one is due."""
        if self._refresh.due(before, trainer.scene) is None:
            return
        begin = time.process_time()
        renewed = trainer.refresh(frame).scene
        self.seconds += time.process_time() - begin
        self.sizes.append(len(encode_keyframe(renewed, time_ns=0)))


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """A camera that never trains.

    Attributes:
        spec: of the clip. camera: that was held out. films: what it filmed, [H,W,3] uint8 a frame.
        first: state of the first frame.
    """

    spec: SyntheticSpec
    camera: Camera
    films: list[UInt8]
    first: Scene

    def quality(self, scene: Scene, index: int) -> float:
        """PSNR in dB of what `scene` shows, against frame `index`."""
        return psnr(self._shown(scene), self._film(index))

    def errors(self, scene: Scene, index: int) -> str:
        """Where the squared error lies, in 1e-5 of the whole picture's mean."""
        now, then = (
            np.square(self._shown(one) - self._film(i)).mean(axis=2) for one, i in ((scene, index), (self.first, 0))
        )
        moving = [surface_motion(self.spec, i, self.camera) > 0 for i in range(1, index + 1)]
        left = np.any(moving, axis=0) & ~moving[-1]
        light = (np.abs(self._film(index) - self._film(0)).max(axis=2) > _DIFFERENT) & ~moving[-1] & ~left
        rest = ~(moving[-1] | left | light)
        places = {"on movers": moving[-1], "where movers were": left, "looks different": light, "elsewhere": rest}
        told = ", ".join(f"{name} {1e5 * float((now * mask).mean()):.0f}" for name, mask in places.items())
        return f"frame {index}: {self.quality(scene, index):.2f} dB, {told} ({1e5 * float((then * rest).mean()):.0f})"

    def _film(self, index: int) -> Float32:
        return np.asarray(self.films[index].astype(np.float32) / 255)

    def _shown(self, scene: Scene) -> Float32:
        splats = expand(scene, self.camera.centre)
        return np.asarray(render(splats, self.camera, scene.header.background).image.clip(0, 1), np.float32)


def warm_up(cameras: tuple[Camera, ...], start: Scene, frame: FrameSet) -> None:
    """Load and compile what a later `frame` takes, outside of any frame's time."""
    trainer = Trainer(cameras, preset("live"), 30.0, "cpu")
    trainer.resume(start)
    residual = trainer.predict(frame).residual
    assert residual is not None
    encode_residual(start, residual, time_ns=0)


def main() -> None:
    options = _options()
    width, height = map(int, options.size.split("x"))
    size = {"frames": options.frames, "width": width, "height": height}
    spec = SyntheticSpec(**size, still=options.still, exposure_drift=options.drift)
    clip = open_synthetic(spec)
    rows = [clip.names.index(name) for name in linspace_split(clip.names, options.views, ("cam00",)).train]
    cameras, filmed = tuple(clip.cameras[row] for row in rows), list(clip.frames())
    training = [FrameSet(f.index, f.time_ns, f.images[rows], f.present[rows]) for f in filmed]
    config = preset("live")
    keyframe = replace(config.keyframe, steps=options.steps)
    if options.refresh_steps is not None:
        keyframe = replace(keyframe, refresh_steps=options.refresh_steps)
    config = replace(config, keyframe=keyframe, seed=options.seed)
    points = first_points(training[0], cameras, depth_bounds=clip.depth_bounds)
    first = Trainer(cameras, config, clip.fps, "cpu").keyframe(training[0], points).scene

    held_out = HeldOut(spec, clip.cameras[0], [frame.images[0] for frame in filmed], first)

    def run(label: str, predict: PredictConfig) -> None:
        budget, chosen = options.budget_ms, replace(config, predict=predict)
        trainer = Trainer(cameras, chosen, clip.fps, "cpu", frame_budget_ms=budget, clock=time.process_time)
        start = with_steps(first, config.predict, predict)
        warm_up(cameras, start, training[1])
        trainer.resume(start)
        trainer.predict(training[0])  # tells the trainer what the first frame was shown
        trainer.resume(start, keep_references=True)
        scores, sizes, motions, seconds = [held_out.quality(first, 0)], list[int](), list[tuple[int, ...]](), 0.0
        keyframes = Keyframes(options.interval)
        for frame in training[1:]:
            before, begin = trainer.scene, time.process_time()
            result = trainer.predict(frame)
            seconds += time.process_time() - begin
            assert result.residual is not None
            encoding = time.process_time()
            sizes.append(len(encode_residual(before, result.residual, time_ns=0)))
            trainer.sent(result, sizes[-1], time.process_time() - encoding)
            scores.append(held_out.quality(result.scene, frame.index))
            if options.errors and frame.index % SHOWN_EVERY == 0:
                print(held_out.errors(result.scene, frame.index), flush=True)
            keyframes.follow(trainer, before, frame)
            if frame.index % MOTION_EVERY == 0 and result.dynamic is not None:
                motion = dynamic_precision_recall(spec, before, result.dynamic, frame.index, cameras)
                motions.append((motion.found, motion.moving, motion.right, motion.dynamic))
        line = " ".join(f"{score:.2f}" for score in scores[::SHOWN_EVERY])
        slope = 100 * np.polyfit(np.arange(len(scores)), scores, 1)[0]
        found, moving, right, dynamic = np.sum(motions, axis=0) if motions else (0, 0, 0, 0)
        count = len(keyframes.sizes)
        print(
            f"{label:24s} {line} | mean {np.mean(scores[1:]):.3f}, {slope:+.2f} dB in 100 frames, "
            f"{np.mean(sizes):.0f} bytes, at most {max(sizes)}, "
            f"{(sum(sizes) + sum(keyframes.sizes)) / len(sizes):.0f} with {count} keyframes, "
            f"{seconds / len(sizes):.3f} CPU s a frame and {keyframes.seconds / max(count, 1):.1f} a keyframe, "
            f"recall {found / max(moving, 1):.2f} of {moving}, precision {right / max(dynamic, 1):.2f} of {dynamic}",
            flush=True,
        )

    run("live", config.predict)
    for changes in options.set:
        predict = config.predict
        for name, value in (change.split("=") for change in changes.split(",")):
            predict = replace(predict, **{name: type(getattr(predict, name))(value)})
        run(changes, predict)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--size", default="240x136")
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--interval", type=int, default=RefreshRule().max_age, help="most frames between keyframes")
    parser.add_argument("--refresh-steps", type=int, help="training of a keyframe in mid-stream")
    parser.add_argument("--budget-ms", type=float, help="frame budget, of CPU time, so that other work does not count")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--still", action="store_true", help="nothing moves but the noise")
    parser.add_argument("--drift", type=float, default=0.0, help="of the cameras' exposures, in stops")
    parser.add_argument("--errors", action="store_true", help="print where the error lies, every tenth frame")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE,...")
    return parser.parse_args()


if __name__ == "__main__":
    main()
