"""Parts of a later frame: a toy one takes part by being in the list, and ours are left out by not being there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest
import torch

from streamlod.core.frames import FrameSet
from streamlod.core.render.raster import Raster
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.frame import started
from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.training import FrameTraining, Hooks
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.progress import Stopwatch
from tests.core.train.later_frame.begun import bare_state, beginning_of
from tests.core.true_points import true_points

SPEC = SyntheticSpec(cameras=3, frames=4, width=48, height=28, seed=1)
CLIP = open_synthetic(SPEC)


@dataclass(frozen=True, slots=True)
class Witness(FramePart):
    """A toy that remembers which hooks ran."""

    name: ClassVar[str] = "witness"
    ran: list[str] = field(default_factory=list)

    def begin(self, seen: Beginning) -> Hooks:
        """As `FramePart.begin`."""
        self.ran.append("begin")
        return _Witnessing(self.ran)


@dataclass
class _Witnessing(Hooks):
    ran: list[str]

    def ready(self, training: FrameTraining) -> None:
        self.ran.append("ready")
        assert training.numbers

    def stepped(self, training: FrameTraining, number: int, raster: Raster, progress: float) -> None:
        self.ran.append("step")
        assert number in training.numbers


@pytest.fixture(scope="module")
def frames() -> list[FrameSet]:
    return list(CLIP.frames())


def configured() -> TrainConfig:
    live = preset("live")
    return replace(
        live,
        keyframe=replace(live.keyframe, steps=20),
        predict=replace(live.predict, epochs=1, minimum_steps=6, most_effort=1.0),
    )


@pytest.fixture(scope="module")
def first(frames: list[FrameSet]) -> Scene:
    return Trainer(CLIP.cameras, configured(), CLIP.fps, "cpu").keyframe(frames[0], true_points(SPEC)).scene


@pytest.mark.long
def test_the_hooks_of_a_part_run_in_order(frames: list[FrameSet], first: Scene) -> None:
    witness = Witness()
    trainer = Trainer(CLIP.cameras, replace(configured(), parts=(witness,)), CLIP.fps, "cpu")
    trainer.resume(first)
    for frame in frames[1:3]:
        trainer.predict(frame)
    assert witness.ran == 2 * ["begin", "ready", *["step"] * 6]


@pytest.mark.parametrize("left_out", [*(part.name for part in preset("live").parts), "all"])
def test_a_frame_trains_without_any_part(frames: list[FrameSet], first: Scene, left_out: str) -> None:
    config = configured()
    parts = () if left_out == "all" else tuple(part for part in config.parts if part.name != left_out)
    trainer = Trainer(CLIP.cameras, replace(config, parts=parts), CLIP.fps, "cpu")
    trainer.resume(first)
    for frame in frames[1:]:
        trained = trainer.predict(frame)
        assert trained.residual is not None
        assert trained.residual.changed > 0
        assert left_out not in trained.report.seconds


def test_a_costly_part_is_left_out_where_there_is_no_time(first: Scene) -> None:
    asked = list[str]()

    def allows(stage: str) -> bool:
        asked.append(stage)
        return False

    costly = [part for part in preset("live").parts if isinstance(part, FramePart) and part.is_costly]
    state = bare_state(first)
    blank = Views(CLIP.cameras, torch.zeros(3, 28, 48, 3), [0, 1, 2])
    trained = np.arange(len(state.field)) < 5
    seen = beginning_of(state, trained, blank, torch.ones(3, 28, 48, dtype=torch.bool))
    assert started(costly, seen, allows, Stopwatch()) == []
    assert asked == [part.name for part in costly] == ["flow_search"]
