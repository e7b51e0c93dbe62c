"""Optimisers by name.

To add one, write a frozen dataclass whose `start` returns a `RowOptimiser`, and name it in `OPTIMISERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from streamlod.core.errors import unknown_name
from streamlod.core.train.optimise.adam import RowAdam


class RowOptimiser(Protocol):
    """Changes named tensors whose rows may come and go.

    Attributes:
        parameters: by name; leaves that require gradients. Others replace them when rows come and go.
    """

    parameters: dict[str, Tensor]

    @property
    def broken(self) -> int:
        """Gradient entries so far that were not finite and were taken as zero."""

    def join(self, parameters: dict[str, Tensor]) -> None:
        """Train further parameters, by names of their own, as if the run began for them now."""

    def step(self, rates: dict[str, float]) -> None:
        """Apply the gradients with the learning rate of each parameter, and clear them."""

    def replace_rows(self, kept: Tensor, added: dict[str, Tensor]) -> None:
        """Keep the rows `kept` of every parameter named in `added` and append its new rows."""


class Optimiser(Protocol):
    """Makes the optimiser of one run."""

    def start(self, parameters: dict[str, Tensor]) -> RowOptimiser:
        """An optimiser of `parameters` that has taken no step."""


@dataclass(frozen=True, slots=True)
class Adam:
    """Adam (Kingma and Ba 2015).

    Attributes:
        memory: beta_1, the share of the mean gradient that each step keeps.
    """

    memory: float = 0.9

    def start(self, parameters: dict[str, Tensor]) -> RowOptimiser:
        """As `Optimiser.start`."""
        return RowAdam(parameters, self.memory)


OPTIMISERS: dict[str, Callable[[float], Optimiser]] = {"adam": Adam}
"""name -> optimiser with a memory of the mean gradient, as `Adam` describes it."""


def optimiser(name: str, memory: float = 0.9) -> Optimiser:
    """The optimiser of that name.

    Raises:
        InputError: there is none.
    """
    if name not in OPTIMISERS:
        raise unknown_name("optimiser", name, OPTIMISERS)
    return OPTIMISERS[name](memory)
