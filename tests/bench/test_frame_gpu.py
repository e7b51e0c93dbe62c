"""The benchmark of frames on a GPU, at a size that a CPU does at once."""

from __future__ import annotations

import pytest

from streamlod.core.train import PredictConfig, TrainConfig
from streamlod.core.train.later_frame.parts import USUAL
from tests.bench.frame_gpu import gpu_report


@pytest.mark.long
def test_every_stage_and_growth_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.bench.frame_gpu._ROUNDS", 1)
    config = TrainConfig(predict=PredictConfig(epochs=1, minimum_steps=0, most_effort=1.0), parts=USUAL)
    found = gpu_report("cpu", config, (150, 300), (2,), (64, 48), moving=0.1)
    for case in ("150 anchors, 2 views", "300 anchors, 2 views"):
        numbers = found[case]
        assert numbers["steps"] == 2
        assert numbers["bytes"] > 0
        assert 0 < numbers["trained"] < 1
        assert numbers["pictures a second"] > 0
        stages = [numbers[f"{stage} s"] for stage in ("compare", "partition", "train", "round", "settle", "encode")]
        assert all(seconds > 0 for seconds in stages)
        assert sum(stages) <= numbers["wall s"]
    assert list(found["growth with anchors"]) == ["150", "300", "exponent"]
    assert list(found["growth with pixels"]) == ["32x24", "64x48", "exponent"]
    assert len(found["growth with the moving share"]) == 4
