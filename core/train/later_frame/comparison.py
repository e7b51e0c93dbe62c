"""The pictures of one instant beside those before it, at full or at half size.

Where things are and what changed is found in pictures of half the size where they are large: a quarter of the work, and
what went far is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.train.later_frame.state import KnownPictures
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

    def differences(self) -> Tensor:
        """[C] squared difference of changed pixels from the references, summed over pixels, mean over channels."""
        squared = (self.views.targets - self.known.references).nan_to_num().square().mean(dim=3)
        return torch.sum(squared * self.masks, dim=(1, 2))
