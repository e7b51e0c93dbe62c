"""How far anchors went in the pictures, by dense optical flow (DIS, Kroeger et al. 2016)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float32, UInt8
from streamlod.core.train.field.field import Field
from streamlod.core.train.pictures.boxes import around
from streamlod.core.train.pictures.parallel import map_pictures
from streamlod.core.train.pictures.projection import projected
from streamlod.core.train.pictures.views import Views

_MIN_SIDE = 16  # pixels; the method refuses smaller pictures
_ROOM = 32  # pixels around those that changed, in which flow is looked for
_VISIBLE = 0.05  # summed opacity of an anchor that shows anything


@dataclass(frozen=True, slots=True, eq=False)
class AnchorFlow:
    """Flow of n anchors in C cameras.

    Attributes:
        seen: [C,n] float32, 1 where an anchor lies on a pixel that goes somewhere, 0 elsewhere.
        flow: [C,n,2] pixels to the right and down that this pixel goes, 0 where none does.
    """

    seen: Tensor
    flow: Tensor

    def of(self, anchors: Tensor) -> AnchorFlow:
        """Only the anchors of `anchors` [n] bool."""
        return AnchorFlow(self.seen[:, anchors], self.flow[:, anchors])


def anchor_flow(field: Field, rows: Tensor, filmed: Tensor, views: Views, masks: Tensor, least: float) -> AnchorFlow:
    """Flow of the anchors `rows` [n], from the pictures `filmed` [C,H,W,3] before to those of `views`.

    What hides an anchor is not asked: other cameras then disagree.

    Args:
        masks: [C,H,W] bool, pixels that changed; the others go nowhere.
        least: pixels that one of these must go.
    """
    count, device = len(views.cameras), rows.device
    seen, flow = torch.zeros(count, len(rows), device=device), torch.zeros(count, len(rows), 2, device=device)
    changed = [number for number in views.usable if masks[number].any()]
    parts = [(number, *around(masks[number], _ROOM)) for number in changed]
    pairs = [(filmed[part].cpu().numpy(), views.targets[part].cpu().numpy()) for part in parts]
    for (number, *box), pixels in zip(parts, map_pictures(picture_flow, pairs), strict=True):
        moved = torch.zeros(*masks[number].shape, 2, device=device)
        moved[tuple(box)] = torch.from_numpy(pixels).to(device)
        going = masks[number] & (moved.norm(dim=2) >= least)
        anchors, row, column = _pixels_of(field, rows, views, number)
        there = going[row, column]
        seen[number, anchors[there]] = 1.0
        flow[number, anchors[there]] = moved[row[there], column[there]]
    return AnchorFlow(seen, flow)


def picture_flow(before: Float32, now: Float32) -> Float32:
    """[H,W,2] pixels to the right and down that each pixel of `before` [H,W,3] in [0, 1] went until `now`.

    Zero where a side has too few pixels for the method.
    """
    if min(before.shape[:2]) < _MIN_SIDE:
        return np.zeros((*before.shape[:2], 2), np.float32)
    finder = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    return np.asarray(finder.calc(_grey(before), _grey(now), None))  # type: ignore[call-overload]


def _grey(picture: Float32) -> UInt8:
    levels = np.clip(picture, 0, 1) * 255
    return np.asarray(cv2.cvtColor(levels.astype(np.uint8), cv2.COLOR_RGB2GRAY))


def _pixels_of(field: Field, rows: Tensor, views: Views, number: int) -> tuple[Tensor, Tensor, Tensor]:
    """Which of the anchors `rows` lie in a camera's picture, and their rows and columns there.

    An anchor lies at the mean of its Gaussians, weighted by opacity.
    """
    with torch.no_grad():
        splats = field.decode(views.centres[number], rows)
    weight = splats.opacities.clamp_min(0).reshape(len(rows), -1, 1)
    opacity = weight.sum(dim=1)
    place = (splats.means.reshape(len(rows), -1, 3) * weight).sum(dim=1) / opacity.clamp_min(1e-6)
    column, row, _, inside = projected(place, views.cameras[number])
    anchors = torch.nonzero(inside & (opacity[:, 0] > _VISIBLE))[:, 0]
    return anchors, row[anchors].long(), column[anchors].long()
