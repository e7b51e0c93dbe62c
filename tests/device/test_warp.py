"""Warp's path on the pretend device: tensors lie there, and what Warp's arrays share with torch lies there too."""

from __future__ import annotations

from typing import Any

import pytest
import warp as wp

import streamlod.core.render.backends
import streamlod.core.train.engine.warp.frame_engine
import streamlod.core.train.trainer
from streamlod.core.render.backends import cuda_fault
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.engine.warp.frame_engine import WarpEngine
from streamlod.core.train.engine.warp.rooms import StepRooms
from streamlod.core.train.presets.settings import Value, with_settings
from tests.core.true_points import true_points
from tests.device.pretend import Counts, DeviceTensor, counted

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.long,  # compiling the kernels takes a minute
    pytest.mark.skipif(cuda_fault() is None or wp.is_cuda_available(), reason="a real GPU is better"),
]
SMALL: dict[str, Value] = {
    "keyframe.steps": 4,
    "keyframe.refresh_steps": 2,
    "predict.epochs": 2,
    "predict.minimum_steps": 0,
}


@pytest.fixture
def warp_gpu(gpu: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Warp computes on the CPU, and shares memory with tensors of the pretend device and no others."""
    from_torch, to_torch = wp.from_torch, wp.to_torch

    def taken(tensor: Any, **named: Any) -> Any:
        assert isinstance(tensor, DeviceTensor), "Warp is given a tensor of the host"
        return from_torch(tensor.held, **named)

    monkeypatch.setattr(wp, "from_torch", taken)
    monkeypatch.setattr(wp, "to_torch", lambda array: DeviceTensor(to_torch(array)))
    monkeypatch.setattr(wp, "device_from_torch", lambda device: wp.get_device("cpu"))
    engine = streamlod.core.train.engine.warp.frame_engine
    monkeypatch.setattr(engine, "StepRooms", lambda device: StepRooms("cpu"))
    monkeypatch.setattr(streamlod.core.render.backends, "warp_fault", lambda: None)


def test_a_stream_mixes_no_devices(warp_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streamlod.core.train.trainer, "select", lambda device: "warp")
    spec = SyntheticSpec(cameras=3, frames=2, width=96, height=54, seed=2)
    clip, (first, second) = open_synthetic(spec), open_synthetic(spec).frames()
    trainer = Trainer(clip.cameras, with_settings(preset("live"), SMALL), clip.fps, "cuda")
    trainer.keyframe(first, true_points(spec))
    trainer.prepare(second)
    assert trainer.predict(second).report.steps > 0
    assert trainer.refresh(second).report.steps > 0


def test_steps_wait_for_the_one_before_alone(warp_gpu: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it a frame budget would ask for all steps at once, and wait for them after its end."""
    taken, counts = WarpEngine.step, Counts()

    def watched(*arguments: Any, **named: Any) -> Any:
        with counted(counts):
            return taken(*arguments, **named)

    monkeypatch.setattr(WarpEngine, "step", watched)
    steps = train_later(monkeypatch, SyntheticSpec(cameras=3, frames=2, width=96, height=54, seed=2), {})
    assert counts.launches
    assert set(counts.waits) == {"event in core/train/engine/warp/frame_engine.py"}
    assert steps // 2 < counts.waits.total() < steps  # one that was done before counts as none


def test_a_network_that_sees_the_view_and_half_size_mix_no_devices(
    warp_gpu: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = SyntheticSpec(cameras=3, frames=2, width=400, height=300, seed=3)
    train_later(monkeypatch, spec, {"model.view_dependent": True})


def train_later(patch: pytest.MonkeyPatch, spec: SyntheticSpec, changes: dict[str, Value]) -> int:
    """A later frame of a clip on the device, after a first one on the CPU; returns its steps."""
    clip, (first, second) = open_synthetic(spec), open_synthetic(spec).frames()
    config = with_settings(preset("live"), SMALL | changes)
    scene = Trainer(clip.cameras, config, clip.fps, "cpu").keyframe(first, true_points(spec)).scene
    patch.setattr(streamlod.core.train.trainer, "select", lambda device: "warp")
    trainer = Trainer(clip.cameras, config, clip.fps, "cuda")
    trainer.resume(scene)
    steps = trainer.predict(second).report.steps
    assert steps > 0
    return steps
