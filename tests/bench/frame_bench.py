"""How fast whole streaming frames are: ``python -m tests.bench.frame_bench [PART ...] [--json FILE]``.

A frame is everything from the pictures to the packet: motion, planning, training, rounding, settling and encoding.
The naive step is what training the whole model does: all anchors decoded through autograd, whole pictures,
convolutions, Adam over every parameter. Subjects alternate; times are of the process's CPU on one thread unless said
otherwise.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from codec.encoder import encode_residual
from codec.packet import PacketKind
from core.render import rasterise
from core.train import PredictConfig, TrainConfig, TrainedFrame, Trainer
from core.train.convert import field_of
from core.train.decode import Network
from tests.bench.frame_subjects import FrameCase, make_case
from tests.bench.raster_subjects import convolution_loss

EPOCHS = 10
VGA = (640, 480)
CONFIG = TrainConfig(predict=PredictConfig(epochs=EPOCHS, minimum_steps=0))


class Streaming:
    """Our frame, from the state before to the packet."""

    def __init__(self, case: FrameCase, config: TrainConfig = CONFIG, device: str = "cpu") -> None:
        self._case = case
        self._trainer = Trainer(case.cameras, config, 30.0, device)
        self.result: TrainedFrame | None = None
        self.packet = b""
        self.reset()

    def reset(self) -> None:
        """Back to the state before, shown its own pictures."""
        self._trainer.resume(self._case.scene)
        self._trainer.predict(self._case.before)

    def run(self) -> None:
        """One frame."""
        before, frames = self._trainer.scene, self._case.after
        self.result = self._trainer.predict(frames)
        assert self.result.residual is not None
        kind = PacketKind.PREDICTED
        self.packet = encode_residual(before, self.result.residual, kind=kind, time_ns=frames.time_ns)


class Naive:
    """Training steps over the whole model."""

    def __init__(self, case: FrameCase) -> None:
        self._cameras = case.cameras
        self._targets = torch.from_numpy(case.after.images).float() / 255
        field = field_of(case.scene)
        names = ("feature", "offset", "scaling", "position")
        self._leaves = {name: getattr(field, name).clone().requires_grad_() for name in names}
        weights = [value.clone().requires_grad_() for value in field.network.parameters()]
        self._field = replace(field, **self._leaves, network=Network(*weights))
        self._optimiser = torch.optim.Adam([*self._leaves.values(), *weights], lr=1e-4)

    def step(self, view: int) -> None:
        """One view, one update."""
        camera = self._cameras[view]
        splats = self._field.decode(torch.from_numpy(camera.centre).float())
        image = rasterise(*splats.astuple(), camera=camera, background=torch.zeros(3)).image
        convolution_loss(image, self._targets[view]).backward()  # type: ignore[no-untyped-call]
        self._optimiser.step()
        self._optimiser.zero_grad()

    def run(self, epochs: int = EPOCHS) -> None:
        """As many steps as a streaming frame has."""
        for _ in range(epochs):
            for view in range(len(self._cameras)):
                self.step(view)


def measured(work: Callable[[], None], clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of one call."""
    begin = clock()
    work()
    return clock() - begin


def whole(rounds: int = 3) -> dict[str, Any]:
    """A frame against as many naive steps: 200k Gaussians, 5 % compact dynamic, 5 views of 640x480, 50 steps."""
    case = make_case(20_000, 5, VGA, 0.05)
    streaming, naive = Streaming(case), Naive(case)
    streaming.run()
    naive.step(0)
    ours, theirs = list[float](), list[float]()
    for _ in range(rounds):
        streaming.reset()
        ours.append(measured(streaming.run))
        theirs.append(measured(naive.run))
    found = {"ours s": min(ours), "naive s": min(theirs)}
    found["naive / ours"] = float(np.median(np.array(theirs) / np.array(ours)))
    return {"200k Gaussians": found | describe(streaming)}


def describe(streaming: Streaming) -> dict[str, Any]:
    """Figures of the frame just trained."""
    assert streaming.result is not None
    report = streaming.result.report
    stages = {f"{stage} s": seconds for stage, seconds in report.seconds.items()}
    return {
        "steps": report.steps,
        "dynamic": report.dynamic / report.anchors,
        "packet bytes": len(streaming.packet),
    } | stages


REPORTS: dict[str, Callable[[], dict[str, Any]]] = {"whole": whole}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help=f"of: {', '.join(REPORTS)}; all by default")
    parser.add_argument("--json", type=Path, help="write every number to this file")
    options = parser.parse_args()
    if set(options.parts) - set(REPORTS):
        parser.error(f"parts are: {', '.join(REPORTS)}")
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    found: dict[str, Any] = {}
    for name in options.parts or REPORTS:
        found[name] = REPORTS[name]()
        print(name)
        for case, numbers in found[name].items():
            texts = [f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in numbers.items()]
            print(f"  {case}: {', '.join(texts)}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
