"""The anchors of the first frame while they are optimised; rows can be added and removed, and steps averaged."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from streamlod.core.train.field.decode import Network
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.field.field import Field
from streamlod.core.train.optimise.adam import RowAdam

ROW_PARAMETERS = ("feature", "offset", "scaling")
_GRID = ("level", "voxel", "extra_level", "position")
NETWORK_PARAMETERS = ("hidden_weight", "hidden_bias", "output_weight", "output_bias")


class LearnedField:
    """A field under optimisation: features, offsets, scalings and the network learn, the grid stays.

    Attributes:
        optimiser: of all that learns, with the mean of its steps.

    Args:
        start: first anchors.
        exposure: gains and offsets that learn along, None for none.
    """

    def __init__(self, start: Field, exposure: Exposure | None) -> None:
        rows = {name: getattr(start, name).clone().requires_grad_() for name in ROW_PARAMETERS}
        network = {name: getattr(start.network, name).clone().requires_grad_() for name in NETWORK_PARAMETERS}
        light = {}
        if exposure is not None:
            light = {"gain": exposure.gain.requires_grad_(), "exposure_offset": exposure.offset.requires_grad_()}
        self.optimiser = RowAdam({**rows, **network, **light})
        self._grid = start

    @property
    def live(self) -> Field:
        """The leaves themselves."""
        return _with(self._grid, self.optimiser.parameters)

    @property
    def settled(self) -> Field:
        """The values now, or their mean since averaging began; not part of any graph."""
        now = {name: value.detach() for name, value in self.optimiser.parameters.items()}
        return _with(self._grid, now | self.optimiser.mean)

    def step(self, rates: dict[str, float]) -> None:
        """Apply the gradients.

        Args:
            rates: of ``feature``, ``offset``, ``scaling``, ``network`` and ``exposure``.
        """
        shared = dict.fromkeys(NETWORK_PARAMETERS, rates["network"])
        light = dict.fromkeys(("gain", "exposure_offset"), rates["exposure"])
        self.optimiser.step(rates | shared | light)

    def keep(self, kept: Tensor, added: dict[str, Tensor] | None = None, extra: Tensor | None = None) -> None:
        """Go on with the anchors `kept`, `extra` [N] levels added to them, and those of `added`.

        Args:
            added: the seven arrays of a field, none by default.
        """
        grid = self.settled
        if extra is not None:
            grid = replace(grid, extra_level=grid.extra_level + extra)
        added = added or {name: getattr(grid, name)[:0] for name in (*ROW_PARAMETERS, *_GRID)}
        self.optimiser.replace_rows(kept, {name: added[name] for name in ROW_PARAMETERS})
        self._grid = grid.with_rows(kept).with_appended(added)

    def regroup(self, grid: Field) -> None:
        """Go on with the same anchors on the octree, levels, nodes and places of `grid`."""
        self._grid = grid


def _with(grid: Field, parameters: dict[str, Tensor]) -> Field:
    return replace(
        grid,
        feature=parameters["feature"],
        offset=parameters["offset"],
        scaling=parameters["scaling"],
        network=Network(*(parameters[name] for name in NETWORK_PARAMETERS)),
    )
