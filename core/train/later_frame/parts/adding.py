"""Anchors are added where the changed pixels' error lies, as long as it is worth their bits."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from streamlod.core.render.raster import Raster
from streamlod.core.scene.octree import Octree, narrowest_cell
from streamlod.core.train.field.convert import motion_cell_of
from streamlod.core.train.growth.errors import ANCHOR_BITS, error_nodes, values_at
from streamlod.core.train.later_frame.comparison import Beginning
from streamlod.core.train.later_frame.training import FrameTraining, Hooks

_ANCHOR_BIT = 5 / 7  # of the price of a residual's bit: an anchor serves for longer than a frame
_ALWAYS_ROOM = 0.125  # share of the most anchors that a scene may always grow to: it may have begun empty


def allowed(seen: Beginning, share: float, room: float) -> int:
    """How many anchors a frame may add: `share` of those alive, while they outnumber the first frame's by `room`."""
    alive, most = seen.state.scene.anchor_count, seen.config.model.max_anchors
    limit = min(most, max(round((1 + room) * seen.first_count), int(_ALWAYS_ROOM * most)))
    return min(int(share * alive), max(limit - alive, 0), seen.max_new)


class Adding(Hooks):
    """Adds anchors once, when all cameras have been drawn and the share `at` of the steps is done; `most` of them."""

    def __init__(self, at: float, most: int, seen: Beginning) -> None:
        self._at, self._most, self._seen = at, most, seen
        self._drawn: dict[int, Tensor] = {}
        self._is_due = True

    def stepped(self, training: FrameTraining, number: int, raster: Raster, progress: float) -> None:
        if not self._is_due:
            return
        self._drawn[number] = raster.image.detach()
        if progress >= self._at and len(self._drawn) == len(training.numbers):
            self._is_due = False
            training.anchors.add(self._new())

    def _new(self) -> dict[str, Tensor]:
        """The seven arrays of the anchors to add."""
        seen, predict = self._seen, self._seen.config.predict
        octree = seen.state.field.octree
        living = seen.state.field.with_rows(torch.nonzero(seen.state.alive)[:, 0])
        living = replace(living, octree=by_width(octree, motion_cell_of(seen.state.scene, predict)))
        price = _ANCHOR_BIT * predict.rate_weight * ANCHOR_BITS
        nodes = error_nodes(living, seen.pictures.views, self._drawn, seen.pictures.masks, self._most, price)
        values = values_at(living, nodes, torch.Generator().manual_seed(len(seen.rows)))
        voxel = torch.from_numpy(octree.voxel_of(nodes.position, nodes.level)).to(living.level.device)
        return values | {"voxel": voxel}


def by_width(octree: Octree, motion_cell: float) -> Octree:
    """`octree` with levels whose cells are as wide as anchors that grow: what they are worth is not known yet."""
    finest = octree.levels - 1
    return replace(octree, root_cell=narrowest_cell(motion_cell) * 2.0**finest)
