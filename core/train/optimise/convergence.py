"""Progress of a training run: where the loss hardly falls any more, the schedule advances faster.

Losses of a GPU are judged a step after the last of them, so that no step waits for its own.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from streamlod.core.train.optimise.host_copy import HostCopy

_WINDOW, _MIN_STEPS = 0.025, 25  # share of the run, and steps, over whose length losses are compared
PLATEAU_STEP_FACTOR = 4  # steps of the schedule that one step counts for while the loss hardly falls


class RunProgress(Protocol):
    """How far a first frame's training is."""

    @property
    def progress(self) -> float:
        """In [0, 1]; 1 when it is over."""

    def advance(self, view: int, loss: Tensor | None) -> None:
        """One step is done; `loss` of `view`'s picture, None where it says nothing about the others."""


class PlateauProgress:
    """How far a run of at most `steps` steps is.

    Losses are compared over windows a fortieth of the run long or longer, view by view, as views differ more than
    windows do.

    Args:
        steps: of a run whose loss falls all the time.
        least_gain: share by which the loss must fall from one window to the next; 0 for runs of exactly `steps`.
        marks: places in the run where losses change for other reasons, and are not compared across.
    """

    def __init__(self, steps: int, least_gain: float, marks: tuple[float, ...]) -> None:
        self._steps, self._least_gain, self._marks = steps, least_gain, marks
        self._length = max(round(_WINDOW * steps), _MIN_STEPS)
        self._done, self._step_factor = 0, 1
        self._phase = -1
        self._window: list[tuple[int, Tensor]] = []
        self._full: tuple[list[int], HostCopy] | None = None  # views and losses of a window that is to be judged
        self._before: dict[int, float] = {}

    @property
    def progress(self) -> float:
        """In [0, 1]; 1 when the run is over."""
        return min(self._done / self._steps, 1.0)

    def advance(self, view: int, loss: Tensor | None) -> None:
        """One step is done.

        Args:
            loss: of `view`'s picture; None where it says nothing about the others.
        """
        phase = sum(self.progress >= mark for mark in self._marks)
        if phase != self._phase:
            self._phase, self._step_factor, self._window, self._full, self._before = phase, 1, [], None, {}
        self._done += self._step_factor
        if self._full is not None:
            self._judge(*self._full)
        if self._least_gain <= 0 or loss is None:
            return
        self._window.append((view, loss.detach()))
        views = [seen for seen, _ in self._window]
        if len(views) >= max(self._length, 2 * len(set(views))):
            self._full, self._window = (views, HostCopy(torch.stack([loss for _, loss in self._window]))), []
            if self._full[1].is_here:
                self._judge(*self._full)

    def _judge(self, views: list[int], losses: HostCopy) -> None:
        """Compare a full window with the one before it."""
        seen: dict[int, list[float]] = {}
        for view, loss in zip(views, losses.read().tolist(), strict=True):
            seen.setdefault(view, []).append(loss)
        now = {view: sum(values) / len(values) for view, values in seen.items()}
        ratios = [now[view] / max(self._before[view], 1e-12) for view in now.keys() & self._before.keys()]
        fell = not ratios or sum(ratios) / len(ratios) < 1 - self._least_gain
        self._step_factor = 1 if fell else PLATEAU_STEP_FACTOR
        self._full, self._before = None, now


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
