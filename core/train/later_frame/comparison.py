"""The pictures of one instant beside those before it, at full or at half size, and what training begins with.

Where things are and what changed is found in pictures of half the size where they are large: a quarter of the work, and
what went far is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.arrays import Bool
from streamlod.core.train.config import TrainConfig
from streamlod.core.train.later_frame.state import KnownPictures, State
from streamlod.core.train.pictures.boxes import tiles_near
from streamlod.core.train.pictures.views import Views, halved_pictures

_HALVED_FROM = 300  # rows of a picture; of smaller ones too little is left


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Pictures of C cameras, now and before.

    Attributes:
        views: cameras, and the pictures that they should show. masks: [C,H,W] bool, pixels that changed.
        known: those before.
    """

    views: Views
    masks: Tensor
    known: KnownPictures

    @property
    def is_large(self) -> bool:
        """Whether half the size is enough to find things."""
        return self.views.targets.shape[1] >= _HALVED_FROM

    def halved(self) -> Comparison:
        """The same at half the width and height; a pixel changed where any did that it covers."""
        views = self.views.halved()
        size = views.targets.shape[1:3]
        masks = functional.adaptive_max_pool2d(self.masks[:, None].float(), size)[:, 0] > 0
        known = self.known
        return Comparison(
            views, masks, KnownPictures(*map(halved_pictures, (known.references, known.filmed, known.shown)))
        )

    def changed_tiles(self, number: int) -> Bool:
        """[tiles_y,tiles_x] bool: tiles in which pixels of camera `number` changed."""
        return tiles_near(self.masks[number].cpu().numpy(), 0)

    def differences(self) -> Tensor:
        """[C] squared difference of changed pixels from the references, summed over pixels, mean over channels."""
        squared = (self.views.targets - self.known.references).nan_to_num().square().mean(dim=3)
        return torch.sum(squared * self.masks, dim=(1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """What is known when the training of a later frame begins.

    Attributes:
        state: before the frame. rows: [n] numbers of its anchors that are trained.
        pictures: of the instant. coarse: the same, at half the size where they are large.
        config: of the stream, whatever rate control makes of it.
        first_count: anchors that the first frame had; max_new: that this frame may add.
    """

    state: State
    rows: Tensor
    pictures: Comparison
    coarse: Comparison
    config: TrainConfig
    first_count: int
    max_new: int
