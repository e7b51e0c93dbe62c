"""Progress of a later frame: where the loss hardly falls any more, the schedule advances faster.

Losses of a GPU are judged a step after the last of them, so that no step waits for its own.
"""

from __future__ import annotations

import torch
from torch import Tensor

from streamlod.core.train.optimise.host_copy import HostCopy

PLATEAU_STEP_FACTOR = 4  # steps of the schedule that one step counts for while the loss hardly falls


class EpochProgress:
    """How far a later frame's run is, which trains every view once before any comes again.

    Where an epoch lowers the mean loss by less than `least_gain` of what epochs did on average before it, the rest
    would gain little: each step then counts for several, so that rates decay and the run ends sooner.

    Args:
        views: steps of an epoch.
        least_gain: 0 to count every step once.
    """

    def __init__(self, views: int, least_gain: float) -> None:
        self._views, self._least_gain = views, least_gain
        self._losses: list[Tensor] = []
        self._ended: HostCopy | None = None  # mean loss of an epoch that is to be judged
        self._means: list[float] = []
        self._step_factor = 1
        self.done = 0

    def anew(self) -> EpochProgress:
        """As far as this one, but with no gains to compare with: losses are of another size from now on."""
        fresh = EpochProgress(self._views, self._least_gain)
        fresh.done = self.done
        return fresh

    def advance(self, loss: Tensor) -> None:
        """One step is done, whose loss was `loss`."""
        self.done += self._step_factor
        if self._least_gain <= 0:
            return
        if self._ended is not None:
            self._judge(self._ended)
        self._losses.append(loss)
        if len(self._losses) == self._views:
            self._ended, self._losses = HostCopy(torch.stack(self._losses).mean()), []
            if self._ended.is_here:
                self._judge(self._ended)

    def _judge(self, mean: HostCopy) -> None:
        """Compare what an epoch gained with what those before it did."""
        self._means.append(float(mean.read()))
        self._ended = None
        if len(self._means) > 2:  # the first gain has nothing to be compared with
            first, *_, before, now = self._means
            average = (first - before) / (len(self._means) - 2)
            self._step_factor = 1 if before - now > self._least_gain * average else PLATEAU_STEP_FACTOR
