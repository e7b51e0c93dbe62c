"""A frame's budget under a clock that the test winds."""

from __future__ import annotations

import pytest

from streamlod.core.train.control.frame_budget import FrameBudget, fixed_steps


class Clock:
    """Seconds that pass only when told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def trained_steps(budget: FrameBudget, clock: Clock, planned: int, step_seconds: float) -> int:
    """Steps that a loop at the budget's pace takes."""
    pace, steps = budget.pace(planned, "encode"), 0
    while pace(steps) < 1:
        clock.work(step_seconds)
        steps += 1
    return steps


def test_without_a_budget_all_steps_are_taken() -> None:
    pace = fixed_steps(4)
    assert [pace(step) for step in range(5)] == [0, 0.25, 0.5, 0.75, 1]
    assert fixed_steps(0)(0) == 1
    clock = Clock()
    budget = FrameBudget(None, clock)
    assert not budget.is_limited
    for _ in range(3):  # whatever stages took
        budget.start()
        clock.work(1e6)
        budget.spent("encode", 1e6)
        assert budget.allows("encode", "round")
        assert [budget.pace(4, "encode")(step) for step in range(5)] == [0, 0.25, 0.5, 0.75, 1]


def test_training_that_fits_is_not_cut_short() -> None:
    clock = Clock()
    budget = FrameBudget(1000, clock)
    assert trained_steps(budget, clock, 20, 0.01) == 20


@pytest.mark.parametrize("step_seconds", [0.01, 0.03, 0.2])
def test_training_ends_before_what_comes_later_would_be_late(step_seconds: float) -> None:
    clock = Clock()
    budget = FrameBudget(1000, clock)
    budget.spent("encode", 0.3)
    budget.start()
    begin = clock.now
    steps = trained_steps(budget, clock, 1000, step_seconds)
    assert clock.now - begin + 0.3 <= 1.0
    assert steps * step_seconds > 0.65 - 2 * step_seconds  # and uses what it may


def test_rates_decay_to_the_end_however_short_the_time() -> None:
    clock = Clock()
    budget = FrameBudget(100, clock)
    pace, reached = budget.pace(1000), list[float]()
    while (progress := pace(len(reached))) < 1:
        reached.append(progress)
        clock.work(0.01)
    assert reached == sorted(reached)
    assert reached[-1] > 0.8


def test_a_budget_that_is_used_up_allows_no_step() -> None:
    clock = Clock()
    budget = FrameBudget(10, clock)
    clock.work(1)
    assert budget.pace(10)(0) >= 1
    assert budget.left() < 0


def test_costs_rise_at_once_and_fall_slowly() -> None:
    clock = Clock()
    budget = FrameBudget(1000, clock)
    assert budget.allows("partition")  # never tried
    budget.spent("partition", 5.0)
    assert not budget.allows("partition")
    budget.spent("partition", 0.1)
    assert not budget.allows("partition")
    for _ in range(20):
        budget.spent("partition", 0.1)
    assert budget.allows("partition")


def test_a_stage_that_was_once_too_slow_is_tried_again() -> None:
    budget = FrameBudget(1000, Clock())
    budget.spent("partition", 3.0)
    refused = 0
    while not budget.allows("partition"):
        refused += 1
    assert 3 <= refused <= 10


def test_a_hitch_of_seconds_is_forgotten_within_a_dozen_frames() -> None:
    """The machine stood still for a minute; since then every stage is quick again."""
    budget, frames = FrameBudget(100, Clock()), 0
    for stage in ("partition", "round", "settle"):
        budget.spent(stage, 60.0)
    while not budget.allows("partition", "round", "settle"):
        frames += 1
        budget.spent("round", 0.01)
        budget.spent("settle", 0.01)
    assert frames <= 12


def test_stages_to_come_are_kept_time_for() -> None:
    budget = FrameBudget(1000, Clock())
    budget.spent("partition", 0.5)
    budget.spent("encode", 0.4)
    assert budget.allows("partition", "encode")
    budget.spent("encode", 0.6)
    assert not budget.allows("partition", "encode")
