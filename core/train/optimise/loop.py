"""The training loop: of a first frame, of every later frame, and of a refresh keyframe."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

AfterStep = Callable[[list[Tensor]], None]
"""Called after every step with all losses so far."""


def run_steps(
    step: Callable[[], Tensor], progress: Callable[[int], float], after: AfterStep = lambda losses: None
) -> list[Tensor]:
    """Take training steps until `progress` is 1; returns the losses.

    Args:
        step: one update; returns its loss [].
        progress: from the number of steps taken, how much of the run is done, in [0, 1].
    """
    losses = list[Tensor]()
    while progress(len(losses)) < 1:
        losses.append(step())
        after(losses)
    return losses
