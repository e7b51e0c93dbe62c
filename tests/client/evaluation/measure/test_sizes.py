"""Shannon's estimate on values whose entropy is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.client.evaluation.measure.footage import Footage
from streamlod.client.evaluation.measure.sizes import (
    KEYFRAME_INTERVAL,
    entropy_bits,
    packet_size,
    shannon_keyframe_bytes,
    shannon_residual_bytes,
    stream_bytes,
)
from streamlod.codec.refresh import RefreshRule
from streamlod.core.frames import PointCloud
from streamlod.core.scene.residual import difference
from streamlod.core.train import Trainer, preset
from streamlod.server.pipeline.job import TrainJob
from tests.client.evaluation.conftest import shortened


def test_entropy_of_known_histograms() -> None:
    assert entropy_bits(np.zeros(100, np.int32)) == 0
    assert entropy_bits(np.array([], np.int32)) == 0
    assert entropy_bits(np.arange(256)) == pytest.approx(256 * 8)
    assert entropy_bits(np.array([0, 1, 1, 1])) == pytest.approx(4 * 2 - 3 * np.log2(3))


def test_a_stream_pays_for_its_keyframes() -> None:
    """Every frame of a stream is predicted, and the first of each interval comes as a keyframe as well."""
    packets = [6000 + 20] + [20] * 99
    assert stream_bytes(6000, 20, interval=100) == pytest.approx(np.mean(packets * 3))
    assert stream_bytes(KEYFRAME_INTERVAL, 0) == 1
    defaults = TrainJob.__dataclass_fields__["keyframe_interval"].default, RefreshRule().max_age
    assert defaults == (KEYFRAME_INTERVAL, KEYFRAME_INTERVAL)


@pytest.mark.long
def test_estimates_are_near_but_below_real_packets(footage: Footage, many_points: PointCloud) -> None:
    """An ideal coder without headers or context, which saves real keyframes about a fifth."""
    trainer = Trainer(footage.training.cameras, shortened(preset("balanced")), 30, "cpu")
    first, second = (pair[0] for pair, _ in zip(footage.pairs(), range(2), strict=False))
    before = trainer.keyframe(first, many_points).scene  # of so many anchors that the header hardly counts
    real = packet_size(None, before, None)
    assert 0.9 * real.total_bytes < shannon_keyframe_bytes(before) < 1.25 * real.total_bytes  # 1.20
    assert sum(real.level_bytes) < real.total_bytes
    trained = trainer.predict(second)
    assert trained.residual is not None
    estimate = shannon_residual_bytes(before, trained.residual)
    assert 0 < estimate < 1.5 * packet_size(before, trained.scene, trained.residual).total_bytes
    still = difference(before, replace(before, version=1))
    assert shannon_residual_bytes(before, still) == 0
    assert packet_size(before, replace(before, version=1), still).total_bytes <= 44 + 12 * len(
        before.levels
    )  # header, directory
