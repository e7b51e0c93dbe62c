"""Rate control against a source whose packets answer to it as a codec's do."""

from __future__ import annotations

import numpy as np
import pytest

from streamlod.core.train.config import PredictConfig
from streamlod.core.train.control.rate_control import UNLIMITED, RateControl

FPS = 30.0


def packets(control: RateControl, activity: list[float], seed: int = 0) -> tuple[list[int], list[float], list[float]]:
    """(sizes, fills, weight factors) of frames in which `activity` anchors want to change, 10 bytes each at weight 1.

    Bytes fall with the square root of the rate weight, and vary by a fifth from frame to frame.
    """
    random = np.random.default_rng(seed)
    sizes, fills, factors = list[int](), list[float](), list[float]()
    for wanted in activity:
        plan = control.plan()
        changed = min(int(wanted), plan.most_anchors)
        size = int(30 + changed * 10 / np.sqrt(plan.weight_factor) * random.uniform(0.8, 1.2))
        control.sent(size, changed)
        sizes.append(size)
        fills.append(control.fill)
        factors.append(plan.weight_factor)
    return sizes, fills, factors


@pytest.mark.parametrize("kbps", [120.0, 300.0, 1000.0])
def test_a_steady_scene_meets_its_rate(kbps: float) -> None:
    sizes, fills, _ = packets(RateControl(kbps, FPS), [600.0] * 300)
    rate = np.mean(sizes[60:]) * 8 * FPS / 1000
    assert rate == pytest.approx(kbps, rel=0.1)
    assert max(fills) <= 1.02


def test_a_burst_never_overflows_the_buffer_and_quality_returns() -> None:
    control = RateControl(300, FPS)
    quiet, burst = [150.0] * 90, [5000.0] * 30
    sizes, fills, factors = packets(control, quiet + burst + quiet)
    assert max(fills) <= 1.05  # bytes an anchor are guessed, so by a packet's spread
    assert max(factors[90:120]) > 2 * factors[89]
    assert factors[-1] <= 1.3 * factors[89]
    # a channel of the rate, with the buffer before it, delivers every packet within the buffer's second and a little
    delay, now = 0.0, 0.0
    for number, size in enumerate(sizes):
        now = max(now, number / FPS) + size * 8 / 300_000
        delay = max(delay, now - number / FPS)
    assert delay <= 1.1


def test_nothing_to_send_costs_nothing_and_relaxes() -> None:
    control = RateControl(300, FPS)
    _, fills, factors = packets(control, [0.0] * 60)
    assert fills[-1] < 0.05
    assert factors[-1] < 0.5
    assert control.plan().most_anchors > 1000


def test_a_keyframe_fills_the_buffer_and_is_written_off() -> None:
    control = RateControl(300, FPS)
    control.sent_keyframe(10_000_000)
    assert control.fill == 1
    _, fills, _ = packets(control, [100.0] * 90)
    assert fills[-1] < 0.5


def test_a_plan_under_strain_trains_less_and_surer() -> None:
    control, config = RateControl(50, FPS), PredictConfig()
    for _ in range(10):
        control.sent(20_000, 2000)
    strained = control.plan().applied(config)
    assert strained.rate_weight > config.rate_weight
    assert config.posterior < strained.posterior < 1
    assert control.plan().most_anchors == 0


@pytest.mark.parametrize("posterior", [0.05, 0.1, 0.7, 0.8])
def test_without_a_rate_settings_stay_to_the_bit(posterior: float) -> None:
    config = PredictConfig(posterior=posterior)
    assert UNLIMITED.applied(config) == config
    assert not UNLIMITED.strained
    assert UNLIMITED.most_changes_beside(UNLIMITED.most_new) > 1 << 38
