"""What later frames train, and what they take to move, against true motion, on all synthetic kinds.

    python -m tests.bench.dynamic_set_bench [--kinds room bright night theatre outdoor hard --speeds 0 4 --frames 21]

For each clip: recall and precision of the dynamic set (docs/history/benchmarks.md), how many anchors a frame trains,
which share of these shows nothing that moves in this frame, and which share has shown nothing that moved in any frame
so far: what moved leaves a background behind that must be trained, too. `--truth` then trains, of all these, only
anchors that show what has moved so far, and tells what that gains or costs.
"""

from __future__ import annotations

import argparse
from dataclasses import astuple, dataclass, field, replace

import numpy as np
import torch

from streamlod.client.evaluation.measure.coverage import coverage
from streamlod.client.evaluation.measure.scores import draw
from streamlod.client.evaluation.measure.truth import MotionScore, dynamic_precision_recall
from streamlod.codec.encoder import encode_residual
from streamlod.core.arrays import Bool
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, surface_motion
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.field.convert import field_of
from streamlod.core.train.motion import cues
from streamlod.core.train.motion.scores import Observation
from tests.bench.moving_bench import Clip, first_frame, open_clip

_PARTLY = 0.1  # of what an anchor shows
_ANY = 0.01  # pixels
_LAST = 5  # frames whose pictures are averaged


@dataclass(slots=True)
class Watched:
    """A motion cue that remembers what it decided last; with `only`, it trains these anchors and no others.

    Attributes:
        cue: that decides.
        only: [N] bool.
        last: its last decision.
    """

    cue: cues.MotionCue
    only: Bool | None = None
    last: Bool = field(default_factory=lambda: np.zeros(0, np.bool_))

    def partition(self, seen: Observation, posterior: float) -> Bool:
        """As `MotionCue.partition`."""
        self.last = self.cue.partition(seen, posterior)
        if self.only is not None:
            self.last = self.last & self.only
        return self.last


@dataclass(slots=True)
class Counts:
    """Sums over the frames of a clip, in anchors; pictures in dB, packets in bytes."""

    scores: list[MotionScore] = field(default_factory=list)
    trained: int = 0
    still: int = 0
    always_still: int = 0
    pictures: list[float] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)

    def told(self) -> str:
        """One line."""
        counts = (sum(count) for count in zip(*map(astuple, self.scores), strict=True))
        whole = MotionScore(*counts) if self.scores else MotionScore(0, 0, 0, 0)
        still, always_still = (count / max(self.trained, 1) for count in (self.still, self.always_still))
        return (
            f"recall {whole.recall:.2f}, precision {whole.precision:.2f}, "
            f"{self.trained / len(self.sizes):.0f} trained, of them {still:.2f} show nothing that moves, "
            f"{always_still:.2f} nothing that moved so far; picture "
            f"{np.mean(self.pictures[-_LAST:]):.2f} dB in the last {_LAST} frames, {np.mean(self.sizes):.0f} bytes"
        )


class Moved:
    """Which pixels of the training cameras show what moves in a frame, and which have shown what moved until then."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self._so_far = [np.zeros((camera.height, camera.width), np.bool_) for camera in clip.cameras]

    def shown(self, before: Scene, index: int) -> tuple[Bool, Bool]:
        """[N] of the anchors of the state before frame `index`: a tenth of what they show moves, has moved so far."""
        whole = field_of(before)
        rows = np.flatnonzero(np.concatenate([level.alive for level in before.levels]))
        alive = torch.from_numpy(rows)
        sums = torch.zeros(len(rows), 3)
        for number, camera in enumerate(self._clip.cameras):
            now = surface_motion(self._clip.spec, index, camera) > _ANY
            self._so_far[number] |= now
            maps = torch.from_numpy(np.stack([np.ones_like(now), now, self._so_far[number]], axis=2)).float()
            sums += coverage(whole, alive, camera, maps)
        found = np.zeros((2, len(whole)), np.bool_)
        found[:, rows] = (sums[:, 1:] >= _PARTLY * sums[:, :1].clamp_min(1e-6)).numpy().T
        return found[0], found[1]


def follow(clip: Clip, config: TrainConfig, first: Scene, truth: bool) -> Counts:
    """Train all frames after the first one; with `truth`, only anchors that show what has moved so far."""
    cue = cues.CUES[config.predict.cue]
    watched = Watched(cue)
    cues.CUES["watched"] = replace(cue, partition=watched.partition)
    config = replace(config, predict=replace(config.predict, cue="watched"))
    trainer = Trainer(clip.cameras, config, clip.fps, "cpu")
    trainer.resume(first)
    trainer.predict(clip.training[0])  # tells the trainer what the first frame was shown
    trainer.resume(first, keep_references=True)
    counts, moved = Counts(), Moved(clip)
    for frame, test in zip(clip.training[1:], clip.testing[1:], strict=True):
        before = trainer.scene
        moves, has_moved = moved.shown(before, frame.index)
        watched.only = has_moved if truth else None
        result = trainer.predict(frame)
        assert result.residual is not None
        trained = watched.last
        counts.trained += int(trained.sum())
        counts.still += int((trained & ~moves).sum())
        counts.always_still += int((trained & ~has_moved).sum())
        counts.sizes.append(len(encode_residual(before, result.residual, time_ns=0)))
        counts.pictures.append(psnr(draw(result.scene, clip.held_out), test.images[0]))
        if result.dynamic is not None:
            counts.scores.append(dynamic_precision_recall(clip.spec, before, result.dynamic, frame.index, clip.cameras))
    return counts


def main() -> None:
    """Print a line for each clip."""
    options = _options()
    width, height = map(int, options.size.split("x"))
    config = preset("live")
    for kind in options.kinds:
        for speed in options.speeds:
            spec = SyntheticSpec(kind=kind, frames=options.frames, width=width, height=height, speed=speed)
            clip = open_clip(spec, options.views)
            first = first_frame(clip, config, None, "cpu")
            for truth in (False, True) if options.truth else (False,):
                told = follow(clip, config, first, truth).told()
                print(f"{kind}, {speed:g} pixels a frame{', only what has moved' if truth else ''}: {told}", flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", default=["room", "bright", "night", "theatre", "outdoor", "hard"])
    parser.add_argument("--speeds", type=float, nargs="+", default=[0.0, 4.0], help="pixels a frame; 0: the kind's own")
    parser.add_argument("--frames", type=int, default=21)
    parser.add_argument("--size", default="240x135")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--truth", action="store_true", help="then train only what has moved so far")
    return parser.parse_args()


if __name__ == "__main__":
    main()
