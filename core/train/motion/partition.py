"""The evidence by which it is decided which anchors a frame trains."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.render.backends import Backend
from streamlod.core.train.field.field import Field
from streamlod.core.train.motion.masks import changed_pixels, least_change, noise_between
from streamlod.core.train.pictures.parallel import map_pictures
from streamlod.core.train.pictures.views import Views


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """The evidence of a motion cue: the state of N anchors, and C cameras' pictures of the next instant.

    Attributes:
        field: the state before; canonical: the keyframe's field, with the same rows.
        alive: [N] bool.
        views: the pictures of the next instant.
        references: [C,H,W,3] pictures that the new ones are compared with, see `State`.
        masks: [C,H,W] bool, pixels that changed against the references, see `change_masks`.
        previous: [N] bool, anchors that the frame before trained.
        backend: of the rasteriser.
    """

    field: Field
    canonical: Field
    alive: Tensor
    views: Views
    references: Tensor
    masks: Tensor
    previous: Bool
    backend: Backend


def change_masks(references: Tensor, before: Tensor, views: Views, floor: float) -> Tensor:
    """[C,H,W] bool: pixels of each usable camera that changed against `references` [C,H,W,3].

    Args:
        before: [C,H,W,3] pictures of the frame before, which tell how noisy cameras are.
        floor: smallest change that counts, in units of [0, 1].
    """
    masks = torch.zeros(references.shape[:3], dtype=torch.bool, device=references.device)
    noise = noise_between(before, views.targets).tolist()
    rows = [
        (references[number].cpu().numpy(), views.targets[number].cpu().numpy(), least_change(noise[number], floor))
        for number in views.usable
    ]
    changed = map_pictures(changed_pixels, rows)
    for number, mask in zip(views.usable, changed, strict=True):
        masks[number] = torch.from_numpy(mask).to(references.device)
    return masks
