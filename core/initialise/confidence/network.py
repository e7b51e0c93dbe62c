"""How likely a pixel's depth is right: a small network over the evidence for it (after Haeusler et al. 2013).

A pixel that must pass a test for every cue is often lost although it is right: what is near, plain or seen at a slant
mostly fails one of them. `python -m tests.bench.confidence_training` fits the weights to what
`python -m tests.bench.confidence_lessons` has made.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from streamlod.core.arrays import Float32

_FILE = "network.npz"
FAR = 4.0  # standard deviations; farther off the usual says no more


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """Two hidden layers of tanh.

    Attributes:
        mean, deviation: [F] of each cue.
        weights: [F,N], [N,N], [N,1]; biases: [N], [N], [1].
    """

    mean: Float32
    deviation: Float32
    weights: tuple[Float32, Float32, Float32]
    biases: tuple[Float32, Float32, Float32]

    def normalised(self, evidence: Float32) -> Float32:
        """[P,F] in standard deviations from the mean."""
        return np.asarray(np.clip((evidence - self.mean) / self.deviation, -FAR, FAR), np.float32)

    def __call__(self, evidence: Float32) -> Float32:
        """[P] from 0 to 1, of the evidence [P,F] for P pixels."""
        values = self.normalised(evidence)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = np.tanh(values @ weight + bias)
        return np.asarray(1 / (1 + np.exp(-(values @ self.weights[-1] + self.biases[-1])[:, 0])), np.float32)


@cache
def usual_confidence() -> Confidence:
    """The network that comes with the program."""
    with (
        (files("streamlod.core.initialise.confidence") / _FILE).open("rb") as file,
        np.load(file, allow_pickle=False) as arrays,
    ):
        weights = arrays["weight0"], arrays["weight1"], arrays["weight2"]
        biases = arrays["bias0"], arrays["bias1"], arrays["bias2"]
        return Confidence(arrays["mean"], arrays["deviation"], weights, biases)
