"""Whole later frames by recorded steps: those of the usual engine, within what rounding and order make of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import warp as wp

import streamlod.core.render.backends
import streamlod.core.train.trainer
from streamlod.client.evaluation.measure.scores import draw
from streamlod.codec.encoder import encode_residual
from streamlod.core.data import Dataset
from streamlod.core.errors import InputError
from streamlod.core.frames import FrameSet
from streamlod.core.metrics import psnr
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import TrainConfig, Trainer, preset
from streamlod.core.train.engine.named import named_engine
from streamlod.core.train.later_frame.engine import EngineMaker
from streamlod.core.train.presets.settings import Value, with_settings
from tests.core.true_points import true_points

pytestmark = pytest.mark.long  # compiling the kernels takes a minute

ENGINES = ("autograd", "warp")
SMALL: dict[str, Value] = {"keyframe.steps": 150, "predict.epochs": 8, "predict.minimum_steps": 0}
CLIPS: dict[str, tuple[SyntheticSpec, dict[str, Value]]] = {
    "as usual": (SyntheticSpec(cameras=4, frames=4, width=96, height=54, seed=2), {}),
    "more moves": (SyntheticSpec(cameras=4, frames=3, width=144, height=81, seed=5), {}),
    "the network sees the view": (
        SyntheticSpec(cameras=3, frames=3, width=96, height=54, seed=7),
        {"model.view_dependent": True},
    ),
    "half size first": (SyntheticSpec(cameras=3, frames=2, width=400, height=300, seed=3), {"predict.epochs": 5}),
}

MINUTES = ("more moves", "half size first")
PARAMETERS = [pytest.param(name, marks=pytest.mark.slow) if name in MINUTES else name for name in CLIPS]


@dataclass(frozen=True)
class Run:
    """Later frames: mean PSNR at the cameras that trained, bytes, anchors added, and steps."""

    psnr: float
    size_bytes: int
    added: int
    steps: int


@cache
def clip_of(name: str) -> tuple[Dataset, TrainConfig, Scene]:
    """A clip, its settings, and its first frame trained."""
    spec, changes = CLIPS[name]
    clip, config = open_synthetic(spec), with_settings(preset("live"), SMALL | changes)
    first = next(iter(clip.frames()))
    return clip, config, Trainer(clip.cameras, config, clip.fps, "cpu").keyframe(first, true_points(spec)).scene


def trainer_of(name: str, engine: str, device: str = "cpu") -> Trainer:
    clip, config, scene = clip_of(name)
    trainer = Trainer(clip.cameras, with_settings(config, {"predict.engine": engine}), clip.fps, device)
    trainer.resume(scene)
    return trainer


@cache
def run_of(name: str, engine: str, device: str = "cpu") -> Run:
    clip, trainer = clip_of(name)[0], trainer_of(name, engine, device)
    size_bytes = added = steps = 0
    for frame in list(clip.frames())[1:]:
        before = trainer.scene
        done = trainer.predict(frame)
        assert done.residual is not None
        size_bytes += len(encode_residual(before, done.residual, time_ns=frame.index))
        added += sum(len(level.added) for level in done.residual.levels)
        steps += done.report.steps
    return Run(quality(trainer.scene, clip, frame), size_bytes, added, steps)


@pytest.mark.parametrize("name", PARAMETERS)
def test_frames_are_those_of_the_usual_engine(name: str) -> None:
    usual, warp = (run_of(name, engine) for engine in ENGINES)
    assert usual.steps == warp.steps > 0
    assert abs(usual.psnr - warp.psnr) < 0.05


@pytest.mark.parametrize(
    ("names", "apart"),
    [
        ([name for name in CLIPS if name not in MINUTES], 0.1),  # of two kilobytes, which chance moves by a twentieth
        pytest.param([*CLIPS], 0.02, marks=pytest.mark.slow),
    ],
)
def test_bytes_are_those_of_the_usual_engine(names: list[str], apart: float) -> None:
    usual, warp = (sum(run_of(name, engine).size_bytes for name in names) for engine in ENGINES)
    assert warp == pytest.approx(usual, rel=apart)


@pytest.mark.slow
def test_anchors_are_added_as_by_the_usual_engine() -> None:
    usual, warp = (sum(run_of(name, engine).added for name in CLIPS) for engine in ENGINES)
    assert min(usual, warp) > 0
    assert warp == pytest.approx(usual, rel=0.2)


@pytest.mark.cuda
@pytest.mark.skipif(not wp.is_cuda_available(), reason="there is no GPU")
@pytest.mark.parametrize("name", CLIPS)
def test_frames_on_a_gpu_are_those_of_the_cpu(name: str) -> None:
    usual, there = run_of(name, "autograd"), run_of(name, "warp", "cuda")
    assert usual.steps == there.steps
    assert abs(usual.psnr - there.psnr) < 0.25  # sums in any order alone make 0.1 dB of so small a clip


def test_a_camera_that_comes_late_is_trained_too() -> None:
    name = "as usual"
    frames, psnrs = list(clip_of(name)[0].frames()), []
    for engine in ENGINES:
        trainer = trainer_of(name, engine)
        present = np.array([True, True, True, False])
        trainer.predict(replace(frames[1], present=present))
        done = trainer.predict(frames[2])
        psnrs.append(psnr(draw(done.scene, clip_of(name)[0].cameras[3]), frames[2].images[3]))
    assert abs(psnrs[0] - psnrs[1]) < 0.05


def test_anchors_may_be_added_after_the_last_step() -> None:
    clip, config, scene = clip_of("more moves")
    last = {"predict.epochs": 1, "new_anchors.at": 0.7, "predict.engine": "warp"}  # 3 of 4 steps
    trainer = Trainer(clip.cameras, with_settings(config, last), clip.fps, "cpu")
    trainer.resume(scene)
    done = trainer.predict(list(clip.frames())[1])
    assert done.report.steps == 4
    assert done.residual is not None
    assert sum(len(level.added) for level in done.residual.levels) > 0


def test_warp_alone_trains_a_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU with a driver alone, whose place the CPU takes: first frame, what moves, recorded steps, keyframe."""
    clip, config, scene = clip_of("as usual")
    monkeypatch.setattr(streamlod.core.train.trainer, "select", lambda device: "warp")
    monkeypatch.setattr(streamlod.core.render.backends, "GPU", "cpu")
    trainer, (first, second, *_) = Trainer(clip.cameras, config, clip.fps), clip.frames()
    done = trainer.keyframe(first, true_points(CLIPS["as usual"][0]))
    assert abs(quality(done.scene, clip, first) - quality(scene, clip, first)) < 1.0
    moved = quality(done.scene, clip, second)
    done = trainer.predict(second)
    assert done.report.steps > 0
    assert quality(done.scene, clip, second) > moved + 0.5
    assert trainer.refresh(second).scene.keyframe == done.scene.version


def quality(scene: Scene, clip: Dataset, frame: FrameSet) -> float:
    """PSNR in the mean of the cameras."""
    return float(
        np.mean([psnr(draw(scene, camera), truth) for camera, truth in zip(clip.cameras, frame.images, strict=True)])
    )


def test_recorded_steps_are_usual_where_warp_draws() -> None:
    config = preset("live")
    assert is_recorded(named_engine(config, "warp", "cpu"))
    assert not is_recorded(named_engine(config, "cpu", "cpu"))
    assert not is_recorded(named_engine(with_settings(config, {"predict.engine": "autograd"}), "warp", "cpu"))
    assert not is_recorded(named_engine(preset("paper"), "warp", "cpu"))


def is_recorded(engine_of: EngineMaker) -> bool:
    return engine_of.__qualname__.startswith("warp_engine")


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"model.selection": "distance"}, "model.selection=all"),
        ({"parts": "gradient_growth"}, "no part gradient_growth"),
    ],
)
def test_what_the_engine_does_not_know_is_refused(changes: dict[str, Value], what: str) -> None:
    clip, config, _ = clip_of("as usual")
    config = with_settings(config, changes | {"predict.engine": "warp"})
    with pytest.raises(InputError, match=what):
        Trainer(clip.cameras, config, clip.fps, "cpu")
