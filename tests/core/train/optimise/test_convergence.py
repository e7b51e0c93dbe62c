"""Runs that end when their loss has fallen as far as it will."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from streamlod.core.train.optimise.convergence import PLATEAU_STEP_FACTOR, EpochProgress, PlateauProgress


def steps_of(run: PlateauProgress, loss: Callable[[int, float], float | None], views: int = 3) -> int:
    """Steps until the run is over, with `loss` of the number of the step and the progress."""
    count = 0
    while run.progress < 1:
        value = loss(count, run.progress)
        run.advance(count % views, None if value is None else torch.tensor(value))
        count += 1
    return count


@pytest.mark.parametrize(
    ("least_gain", "loss"),
    [
        (0.0, lambda *_: 1.0),  # nothing was asked for
        (0.02, lambda step, _: 0.995**step * (1 + step % 3)),  # falls, and views differ
        (0.02, lambda *_: None),  # nothing is known
    ],
)
def test_a_run_takes_all_its_steps_while_that_pays(
    least_gain: float, loss: Callable[[int, float], float | None]
) -> None:
    assert steps_of(PlateauProgress(700, least_gain, ()), loss) == 700


def test_a_loss_that_stands_still_ends_the_run_in_a_third_of_its_steps() -> None:
    assert 250 <= steps_of(PlateauProgress(1000, 0.02, ()), lambda *_: 0.1) < 333
    marks = (0.4, 0.65, 0.75)  # after each of them the loss is given a chance again
    assert 250 < steps_of(PlateauProgress(1000, 0.02, marks), lambda *_: 0.1) < 500


def test_a_run_in_haste_slows_down_when_the_loss_falls_again() -> None:
    """Full-size pictures halfway: the loss jumps, falls for a while, and stands still."""

    def loss(_: int, progress: float) -> float:
        return 0.1 if progress < 0.5 else 0.2 * 0.9 ** (100 * min(progress - 0.5, 0.25))

    assert steps_of(PlateauProgress(1000, 0.02, (0.5,)), lambda *_: 0.1) < 400
    assert 450 < steps_of(PlateauProgress(1000, 0.02, (0.5,)), loss) < 600


def test_many_views_are_each_seen_twice_before_they_are_compared() -> None:
    """Views of very different losses, more of them than a window has steps: only their own change counts."""
    assert (
        steps_of(PlateauProgress(400, 0.02, ()), lambda step, _: 0.99**step * (1 + 50 * (step % 40)), views=40) == 400
    )


def steps_until(least_gain: float, total: int, mean: Callable[[int], float], views: int = 5) -> int:
    """Steps of a later frame's run of `total`, whose losses spread over the views around `mean` of the epoch."""
    epochs, count = EpochProgress(views, least_gain), 0
    while epochs.done < total:
        epochs.advance(torch.tensor(mean(count // views) * (1 + 10 * ((3 * count) % views))))
        count += 1
    return count


def test_a_later_frame_takes_all_its_steps_while_each_epoch_gains() -> None:
    assert steps_until(0.5, 80, lambda epoch: 1 - 0.02 * epoch) == 80
    assert steps_until(0.0, 80, lambda _: 1.0) == 80
    assert steps_until(0.5, 10, lambda _: 1.0) == 10  # two epochs leave nothing to compare


def test_a_later_frame_whose_loss_stands_still_ends_four_times_as_fast() -> None:
    """What counts is the gain beside what was gained before, not beside the static error."""
    saturating = [1 - 0.1 * (1 - 0.4**epoch) for epoch in range(20)]
    assert steps_until(0.5, 80, lambda epoch: saturating[epoch]) == 15 + (80 - 15) // 4 + 1
    with_static_error = [10 + one for one in saturating]
    assert steps_until(0.5, 80, lambda epoch: with_static_error[epoch]) == 15 + (80 - 15) // 4 + 1
    assert steps_until(0.5, 80, lambda epoch: 1 + 0.1 * epoch**2) < 35  # it gets worse and worse


def test_a_later_frame_slows_down_when_it_gains_again() -> None:
    def loss(epoch: int) -> float:
        return 1.0 - 0.1 * min(epoch, 1) if epoch < 4 else 0.9 - 0.2 * (epoch - 3)

    assert steps_until(0.5, 80, loss) > steps_until(0.5, 80, lambda epoch: 1.0 - 0.1 * min(epoch, 1)) + 10


@pytest.mark.cuda
def test_losses_of_a_gpu_are_judged_a_step_later(gpu: str) -> None:
    generator = torch.Generator().manual_seed(0)
    losses = [float(loss) for loss in torch.rand(200, generator=generator) * 0.97 ** torch.arange(200).clamp(max=90)]

    def later_frame(device: str) -> list[float]:
        run, done = EpochProgress(3, 0.5), list[float]()
        for loss in losses:
            run.advance(torch.tensor(loss).to(device))
            done.append(run.done)
        return done

    def first_frame(device: str) -> list[float]:
        run, done = PlateauProgress(1000, 0.02, ()), list[float]()
        for number, loss in enumerate(losses):
            run.advance(number % 3, torch.tensor(loss).to(device))
            done.append(1000 * run.progress)
        return done

    for frame in (later_frame, first_frame):
        here, there = (np.diff(frame(device)).round() for device in ("cpu", gpu))
        assert {1, PLATEAU_STEP_FACTOR} == set(here)
        np.testing.assert_array_equal(there[1:], here[:-1])
