"""Runs that end when their loss has fallen as far as it will."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from streamlod.core.train.optimise.convergence import PLATEAU_STEP_FACTOR, EpochProgress


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

    here, there = (np.diff(later_frame(device)) for device in ("cpu", gpu))
    assert {1, PLATEAU_STEP_FACTOR} == set(here)
    np.testing.assert_array_equal(there[1:], here[:-1])


def test_pictures_of_another_size_do_not_count_as_a_gain() -> None:
    """A loss that is lower from one step to the next is no gain, if something else is measured from then on."""
    first = EpochProgress(1, 0.5)
    for loss in (1.0, 0.9, 0.8):
        first.advance(torch.tensor(loss))
    anew = first.anew()
    assert anew.done == first.done == 3
    for loss in (0.2, 0.1, 0.0):  # gains as much as before
        anew.advance(torch.tensor(loss))
    assert anew.done == 6
    first.advance(torch.tensor(0.2))  # would make all later gains look small
    first.advance(torch.tensor(0.1))
    first.advance(torch.tensor(0.0))
    assert first.done > 6
