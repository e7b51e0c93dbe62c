"""What a frame's training does with each anchor, and what that is decided from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Int64
from streamlod.core.render.backends import Backend
from streamlod.core.train.field.field import Field
from streamlod.core.train.motion.masks import changed_pixels
from streamlod.core.train.pictures.parallel import map_pairs
from streamlod.core.train.pictures.views import Views


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """What a frame's training does with N anchors.

    Attributes:
        dynamic: [N] bool, anchors that are taken to move; None where that was not asked for.
        trained: [N] bool, those and the others that look different: shadows, reflections, what was uncovered.
    """

    dynamic: Bool | None
    trained: Bool

    def among(self, alive: Bool) -> Partition:
        """Only the anchors of `alive` [N]."""
        return Partition(None if self.dynamic is None else self.dynamic & alive, self.trained & alive)

    def reordered(self, origin: Int64) -> Partition:
        """For anchors in another order: `origin` [M] is the row of each before, -1 for a new one, which is dynamic."""
        rows, new = np.maximum(origin, 0), origin < 0
        dynamic = None if self.dynamic is None else new | self.dynamic[rows]
        return Partition(dynamic, new | self.trained[rows])


def all_static(anchors: int) -> Partition:
    """No anchor is trained."""
    return Partition(np.zeros(anchors, np.bool_), np.zeros(anchors, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """What a motion cue decides from: the state of N anchors, and C cameras' pictures of the next instant.

    Attributes:
        field: the state before; canonical: the keyframe's field, with the same rows.
        alive: [N] bool.
        views: the pictures of the next instant.
        references: [C,H,W,3] pictures that the new ones are compared with, see `State`.
        filmed: [C,H,W,3] the same as they were filmed: what the state shows wrongly has not moved.
        masks: [C,H,W] bool, pixels that changed against the references, see `change_masks`.
        previous: the partition of the frame before.
        steady: [N] bool, anchors that training keeps moving.
        backend: of the rasteriser.
        label: also say which of the trained anchors move, which may take drawing the scene twice more.
    """

    field: Field
    canonical: Field
    alive: Tensor
    views: Views
    references: Tensor
    filmed: Tensor
    masks: Tensor
    previous: Partition
    steady: Bool
    backend: Backend
    label: bool = True


def change_masks(references: Tensor, views: Views, floor: float) -> Tensor:
    """[C,H,W] bool: pixels of each usable camera that changed against `references` [C,H,W,3].

    Args:
        floor: smallest change that counts, in units of [0, 1].
    """
    masks = torch.zeros(references.shape[:3], dtype=torch.bool, device=references.device)
    pairs = [(references[number].cpu().numpy(), views.targets[number].cpu().numpy()) for number in views.usable]
    changed = map_pairs(partial(changed_pixels, floor=floor), pairs)
    for number, mask in zip(views.usable, changed, strict=True):
        masks[number] = torch.from_numpy(mask).to(references.device)
    return masks
