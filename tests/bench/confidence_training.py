"""Fits the network that says which depths of first points to believe (core/initialise/confidence/network.py).

    python -m tests.bench.confidence_lessons --data DATA --out LESSONS
    python -m tests.bench.confidence_training --lessons LESSONS [--out core/initialise/confidence/network.npz]

First each scene is left out in turn, and what the others teach is asked of it; then the network of all scenes is
written.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from streamlod.core.arrays import Bool, Float32
from streamlod.core.initialise.confidence.evidence import CUES
from streamlod.core.initialise.confidence.network import FAR, Confidence
from streamlod.core.initialise.methods.learned import LEAST_CONFIDENCE
from tests.bench.confidence_lessons import Lesson, read_lessons

_RIGHT = 0.03  # relative error of a depth that is right
_NEARNESS, _MOST = 3.0, 50.0  # exponent of a wrong depth's weight, and the largest one
_NEAREST = 0.05  # of the true depth: nearer weighs no more
_PIXELS, _UNITS, _BATCH, _STEPS, _RATE = 8000, 24, 4096, 2500, 1e-2  # pixels: of each lesson, at most


def sampled(lesson: Lesson, generator: np.random.Generator) -> tuple[Float32, Bool, Float32]:
    """Evidence [N,F], which of it is right [N] and what it weighs [N], of at most `_PIXELS` that are known.

    A wrong depth weighs the more the nearer to the camera it is than the true one, since it then covers the more of
    other pictures.
    """
    chosen = generator.permutation(np.flatnonzero(~np.isnan(lesson.error)))[:_PIXELS]
    error = lesson.error[chosen]
    right = np.abs(error) < _RIGHT
    nearness = np.clip((1 / np.maximum(1 + error, _NEAREST)) ** _NEARNESS, 1, _MOST)
    return lesson.evidence[chosen], right, np.where(right, 1, nearness).astype(np.float32)


def fitted(taught: list[Lesson], seed: int = 0) -> Confidence:
    """A network that has learnt `taught`, each lesson with as much weight as it has pixels, up to `_PIXELS`."""
    generator = np.random.default_rng(seed)
    torch.manual_seed(seed)
    samples = [sampled(lesson, generator) for lesson in taught]
    cues, right, weight = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    mean, deviation = cues.mean(axis=0), cues.std(axis=0) + 1e-6
    known = torch.from_numpy(np.clip((cues - mean) / deviation, -FAR, FAR))
    wanted, weighs = torch.from_numpy(right.astype(np.float32)), torch.from_numpy(weight)
    layers = [torch.nn.Linear(cues.shape[1], _UNITS), torch.nn.Linear(_UNITS, _UNITS), torch.nn.Linear(_UNITS, 1)]
    network = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimiser = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=_STEPS)
    for _ in range(_STEPS):
        batch = torch.randint(len(known), (_BATCH,))
        logits = network(known[batch])[:, 0]
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, wanted[batch], weighs[batch])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    weights = [layer.weight.detach().numpy().T.copy() for layer in layers]
    biases = [layer.bias.detach().numpy().copy() for layer in layers]
    return Confidence(mean, deviation, (weights[0], weights[1], weights[2]), (biases[0], biases[1], biases[2]))


def judged(confidence: Confidence, lesson: Lesson) -> str:
    """One line: what is above the threshold, what the tests let pass, how much of both is right, and far too near.

    What becomes a point is less: it must lie in a gap, and other views must agree.
    """
    texts = []
    for name, chosen in (
        ("above the threshold", confidence(lesson.evidence) > LEAST_CONFIDENCE),
        ("the tests", lesson.trusted),
    ):
        error = lesson.error[chosen & ~np.isnan(lesson.error)]
        right, near = (np.abs(error) < _RIGHT).mean(), (error < -2 * _RIGHT).mean()
        texts.append(f"{name} {chosen.mean():.3f} of the pixels, {right:.3f} rightly, {near:.3f} much too near")
    return f"{lesson.scene}, {lesson.views} views: " + "; ".join(texts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--lessons", type=Path, required=True, help="the folder of the lessons")
    parser.add_argument("--out", type=Path, help="where to write the weights (none: only judge)")
    options = parser.parse_args()
    known = read_lessons(options.lessons)
    if not known:
        parser.error(f"{options.lessons} has no lessons: make some with tests.bench.confidence_lessons")
    for scene in dict.fromkeys(lesson.scene for lesson in known):
        confidence = fitted([lesson for lesson in known if lesson.scene != scene])
        for lesson in (lesson for lesson in known if lesson.scene == scene):
            print(judged(confidence, lesson), flush=True)
    if options.out:
        found = fitted(known)
        layers = {f"weight{n}": weight for n, weight in enumerate(found.weights)}
        layers |= {f"bias{n}": bias for n, bias in enumerate(found.biases)}
        np.savez(options.out, cues=np.array(CUES), mean=found.mean, deviation=found.deviation, **layers)


if __name__ == "__main__":
    main()
