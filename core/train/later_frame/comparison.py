"""The pictures of one instant beside those before it, at full or at half size.

Where things are and what changed is found in pictures of half the size where they are large: a quarter of the work, and
what went far is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.train.pictures.views import Views, halved_pictures

_HALVED_FROM = 300  # rows of a picture; of smaller ones too little is left


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Pictures of C cameras, now and before.

    Attributes:
        views: cameras, and the pictures that they should show. masks: [C,H,W] bool, pixels that changed.
        references: [C,H,W,3] what the new ones are compared with. filmed: [C,H,W,3] those of the frame before.
        shown: [C,H,W,3] what the cameras would film of the state before, NaN where unknown; None: of nothing.
    """

    views: Views
    masks: Tensor
    references: Tensor
    filmed: Tensor
    shown: Tensor | None

    @property
    def is_large(self) -> bool:
        """Whether half the size is enough to find things."""
        return self.views.targets.shape[1] >= _HALVED_FROM

    def halved(self) -> Comparison:
        """The same at half the width and height; a pixel changed where any did that it covers."""
        views = self.views.halved()
        size = views.targets.shape[1:3]
        masks = functional.adaptive_max_pool2d(self.masks[:, None].float(), size)[:, 0] > 0
        shown = None if self.shown is None else halved_pictures(self.shown)
        return Comparison(views, masks, halved_pictures(self.references), halved_pictures(self.filmed), shown)

    def differences(self) -> Tensor:
        """[C] squared difference of changed pixels from the references, summed over pixels, mean over channels."""
        squared = (self.views.targets - self.references).nan_to_num().square().mean(dim=3)
        return torch.sum(squared * self.masks, dim=(1, 2))
