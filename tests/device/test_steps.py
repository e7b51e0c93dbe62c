"""Training steps on the pretend device ask for few launches, and only one of the first frame's waits for an answer."""

from __future__ import annotations

from dataclasses import replace

import pytest

from streamlod.core.render.backends import cuda_fault
from streamlod.core.synthetic import SyntheticSpec, open_synthetic
from streamlod.core.train import Trainer, preset
from streamlod.core.train.keyframe.trainer import KeyframeTrainer
from streamlod.core.train.later_frame.autograd.engine import AutogradEngine
from tests.bench.launches_bench import measured
from tests.core.true_points import true_points
from tests.device.pretend import Counts, counted

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(cuda_fault() is None, reason="a real GPU does not tell its launches"),
]
MAX_LAUNCHES = 240  # of a step (234 when this was set)

ONCE = {f"core/train/keyframe/{name}.py" for name in ("precision", "drawing")}


@pytest.mark.long
def test_steps_do_not_wait(gpu: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = SyntheticSpec(cameras=3, frames=2, width=64, height=36, seed=2)
    clip, config = open_synthetic(spec), preset("live")
    # without growth, which asks the host; rounded early
    config = replace(
        config,
        keyframe=replace(config.keyframe, steps=30, growth_until=0.0, rounding_from=0.4, average_from=0.4),
        predict=replace(config.predict, epochs=4, minimum_steps=0),
    )
    steps = list[Counts]()
    for trained, name in ((KeyframeTrainer, "step"), (AutogradEngine, "step")):
        whole = getattr(trained, name)

        def watched(*arguments: object, whole: object = whole, **settings: object) -> object:
            assert callable(whole)
            with counted() as counts:
                found: object = whole(*arguments, **settings)
            steps.append(counts)
            return found

        monkeypatch.setattr(trained, name, watched)
    trainer = Trainer(clip.cameras, config, clip.fps, "cuda")
    first, second = clip.frames()
    trainer.keyframe(first, true_points(spec))
    later = len(steps)
    trainer.predict(second)
    assert len(steps) >= later + 4 * len(clip.cameras)
    waiting = [counts.waits for counts in steps[:later] if counts.waits]
    assert len(waiting) == 1  # how numbers are rounded is measured once
    assert {name.split()[-1] for waits in waiting for name in waits} <= ONCE
    assert not any(counts.waits for counts in steps[later:])
    usual = sorted(sum(counts.launches.values()) for counts in steps[:later])[later // 2]
    assert max(usual, *(sum(counts.launches.values()) for counts in steps[later:])) < MAX_LAUNCHES


@pytest.mark.long
def test_the_bench_counts_what_one_of_many_steps_does_by_itself() -> None:
    config = preset("live")
    config = replace(config, keyframe=replace(config.keyframe, steps=30))
    clip = open_synthetic(SyntheticSpec(cameras=3, frames=1, width=64, height=36, seed=2))
    first = measured(clip, config)["first frame"]
    assert first.steps == 30
    assert not first.step.waits
    assert first.refining.waits
