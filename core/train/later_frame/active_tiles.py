"""Which anchors are worth training where little of the pictures changed.

A few Gaussians are as wide as a wall. Trained for what passes before them, they make every step draw and differentiate
whole pictures, and spoil what has not changed. So only anchors are trained that mostly show in active tiles: those with
changed pixels, and a border. A change of light makes all tiles active, and with them the wide ones.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera
from streamlod.core.render.cpu.dirty_tiles import reached_tiles
from streamlod.core.train.field.field import Field

BORDER = 24  # pixels around those that changed
_LEAST_SHARE = 0.5  # of the tiles that an anchor reaches, which must be active


def mostly_active(field: Field, rows: Tensor, cameras: tuple[Camera, ...], active: Mapping[int, Bool]) -> Bool:
    """[n] bool: whether most of the tiles that anchors `rows` [n] reach are `active`, by the number of the camera.

    Cameras in which an anchor reaches no active tile are not asked: something may hide it there.
    """
    counts, splats = np.zeros((len(rows), 2)), None
    for number, tiles in active.items():
        if splats is None or not field.looks_the_same:
            with torch.no_grad():
                splats = field.decode(torch.from_numpy(cameras[number].centre).float(), rows)
        of_slots = reached_tiles(cameras[number], splats.cloud(), tiles)
        of_anchors = of_slots.reshape(len(rows), field.slots, 2).sum(axis=1)
        counts += of_anchors * (of_anchors[:, 1:] > 0)
    return np.asarray((counts[:, 1] > 0) & (counts[:, 1] >= _LEAST_SHARE * counts[:, 0]))
