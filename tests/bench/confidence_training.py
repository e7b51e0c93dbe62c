"""Fits the network that says which depths of first points to believe (core/initialise/confidence.py).

    python -m tests.bench.confidence_training --data DATA [--out core/initialise/confidence.npz]

Learns from the choosing half of the zoo alone: synthetic kinds, whose depth is known, and recordings, where a depth
that few cameras measure is right if trusted depths of all cameras but the held-out one agree with it, wrong if two of
them look through it, and left out otherwise. First each scene is left out in turn, and what the others teach is
asked of it; then the network of all scenes is written.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch

from client.evaluation.zoo.scenes import SCENES, ZooScene
from core.arrays import Bool, Float32, Int64
from core.data import Dataset, linspace_split
from core.initialise.confidence import FAR, Confidence
from core.initialise.consistency import votes
from core.initialise.evidence import CUES, Matches, evidence
from core.initialise.methods.learned import LearnedSweep
from core.initialise.methods.plane_sweep import PlaneSweep
from core.initialise.views import working_views
from core.synthetic import SyntheticSpec, open_synthetic, render_frame

_VIEWS = (3, 4, 5, 6, 8)
_DOWNSCALE = 2.0
_OTHER = {"seed": 1, "exposure_spread": 0.3}  # a second version of each synthetic kind
_RIGHT = 0.03  # relative error of a depth that is right
_PIXELS, _UNITS, _BATCH, _STEPS, _RATE = 8000, 24, 4096, 2500, 1e-2  # pixels: of each lesson, at most


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Pixels of one choice of cameras: evidence [P,F], whether the depth is right [P], whether it was trusted [P]."""

    scene: str
    views: int
    evidence: Float32
    right: Bool
    trusted: Bool

    def sampled(self, generator: np.random.Generator) -> tuple[Float32, Bool]:
        """At most `_PIXELS` of them."""
        chosen = generator.permutation(len(self.right))[:_PIXELS]
        return self.evidence[chosen], self.right[chosen]


def lessons(data: Path) -> Iterator[Lesson]:
    """All of the choosing half."""
    for scene in (scene for scene in SCENES if scene.half == "choosing"):
        spec = scene.spec(_DOWNSCALE)
        if spec is not None:
            for version in (spec, replace(spec, **_OTHER)):
                yield from _synthetic(scene, version)
        elif (whole := scene.open(data, _DOWNSCALE)) is not None:
            yield from _recorded(scene, whole)


def _matches(whole: Dataset, names: tuple[str, ...]) -> Matches:
    part, sweep = whole.select(names), PlaneSweep()
    frame = next(iter(part.frames(0, 1)))
    return sweep.matches(working_views(frame, part.cameras, sweep.rows), whole.depth_bounds)


def _synthetic(scene: ZooScene, spec: SyntheticSpec) -> Iterator[Lesson]:
    whole = open_synthetic(spec)
    for views in _VIEWS:
        names = linspace_split(whole.names, views, (scene.held_out,)).train
        matches, labels = _matches(whole, names), []
        for name, depth_map in zip(names, matches.maps, strict=True):
            height, width = depth_map.depth.shape
            truth = render_frame(spec, 0, whole.names.index(name)).depth
            truth = np.asarray(cv2.resize(truth, (width, height), interpolation=cv2.INTER_NEAREST), np.float32)
            labels.append((np.abs(depth_map.depth / truth - 1) < _RIGHT).astype(np.int64))
        yield _lesson(scene.name, matches, labels)


def _recorded(scene: ZooScene, whole: Dataset) -> Iterator[Lesson]:
    every = _matches(whole, tuple(name for name in whole.names if name != scene.held_out))
    sure = [
        replace(depth_map, depth=np.where(good, depth_map.depth, np.float32(np.inf)))
        for depth_map, good in zip(every.maps, every.trusted, strict=True)
    ]
    for views in _VIEWS:
        matches, labels = _matches(whole, linspace_split(whole.names, views, (scene.held_out,)).train), []
        for depth_map in matches.maps:
            agreeing, through = votes(depth_map.points(), -1, sure, _RIGHT)
            labels.append(np.where(agreeing > through, 1, np.where(through >= 2, 0, -1)))
        yield _lesson(scene.name, matches, labels)


def _lesson(scene: str, matches: Matches, labels: list[Int64]) -> Lesson:
    """Args: labels: of each view, 1 where its depth is right, 0 where it is wrong, -1 where nobody knows."""
    label = np.concatenate([found.ravel() for found in labels])
    trusted, known = np.concatenate([good.ravel() for good in matches.trusted]), label >= 0
    return Lesson(scene, len(labels), np.concatenate(evidence(matches))[known], label[known] == 1, trusted[known])


def fitted(taught: list[Lesson], seed: int = 0) -> Confidence:
    """A network that has learnt `taught`, each lesson with as much weight as it has pixels, up to `_PIXELS`."""
    generator = np.random.default_rng(seed)
    torch.manual_seed(seed)
    samples = [lesson.sampled(generator) for lesson in taught]
    cues, right = np.concatenate([sample[0] for sample in samples]), np.concatenate([sample[1] for sample in samples])
    mean, deviation = cues.mean(axis=0), cues.std(axis=0) + 1e-6
    known = torch.from_numpy(np.clip((cues - mean) / deviation, -FAR, FAR))
    wanted = torch.from_numpy(right.astype(np.float32))
    layers = [torch.nn.Linear(cues.shape[1], _UNITS), torch.nn.Linear(_UNITS, _UNITS), torch.nn.Linear(_UNITS, 1)]
    network = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=_STEPS)
    for _ in range(_STEPS):
        batch = torch.randint(len(known), (_BATCH,))
        loss = torch.nn.functional.binary_cross_entropy_with_logits(network(known[batch])[:, 0], wanted[batch])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    weights = [layer.weight.detach().numpy().T.copy() for layer in layers]
    biases = [layer.bias.detach().numpy().copy() for layer in layers]
    return Confidence(mean, deviation, (weights[0], weights[1], weights[2]), (biases[0], biases[1], biases[2]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, required=True, help="the folder of the recordings")
    parser.add_argument("--out", type=Path, help="where to write the weights (none: only judge)")
    options = parser.parse_args()
    known = []
    for lesson in lessons(options.data):  # most of the time
        known.append(lesson)
        print(f"{lesson.scene}, {lesson.views} views: {len(lesson.right)} pixels", flush=True)
    for scene in dict.fromkeys(lesson.scene for lesson in known):
        confidence = fitted([lesson for lesson in known if lesson.scene != scene])
        for lesson in (lesson for lesson in known if lesson.scene == scene):
            believed = confidence(lesson.evidence) > LearnedSweep().least_confidence
            (now, right), (then, before) = (
                (chosen.mean(), lesson.right[chosen].mean()) for chosen in (believed, lesson.trusted)
            )
            print(
                f"{scene}, {lesson.views} views: believes {now:.3f} of the pixels, {right:.3f} of these rightly; "
                f"the tests alone {then:.3f}, {before:.3f}",
                flush=True,
            )
    if options.out:
        found = fitted(known)
        layers = {f"weight{n}": weight for n, weight in enumerate(found.weights)}
        layers |= {f"bias{n}": bias for n, bias in enumerate(found.biases)}
        np.savez(options.out, cues=np.array(CUES), mean=found.mean, deviation=found.deviation, **layers)


if __name__ == "__main__":
    main()
