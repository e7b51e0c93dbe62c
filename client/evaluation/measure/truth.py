"""The dynamic set against true motion, for clips that come with ground truth.

An anchor has no surface of its own. What it *shows* is measured by its blending weights, summed over the pixels of the
training pictures. It truly moves when at least half of what it shows moves by a quarter of a pixel or more in this
step; a dynamic anchor is right when at least a tenth of what it shows moves at all. Between the two, either answer is
accepted. Surfaces count, not appearances: shadows, highlights, reflections and uncovered background are false alarms.
Anchors seen by less than 0.3 pixels never count as moving; a dynamic one that no camera sees is a false alarm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from streamlod.client.evaluation.measure.coverage import coverage
from streamlod.core.arrays import Bool, Float64
from streamlod.core.camera import Camera
from streamlod.core.scene.anchors import Scene
from streamlod.core.synthetic import SyntheticSpec, surface_motion
from streamlod.core.train.field.convert import field_of

_VISIBLE = 0.25  # pixels in one step: the motion precision of H.264 and HEVC
_ANY = 0.01  # pixels
_MOSTLY, _PARTLY = 0.5, 0.1  # of what an anchor shows
_SEEN = 0.3  # pixels, over all training pictures


@dataclass(frozen=True, slots=True)
class MotionScore:
    """How well the dynamic anchors agree with those that truly move.

    Attributes:
        dynamic: anchors that were taken to move.
        right: of them, those that show something that moves.
        moving: anchors that mostly show what visibly moves.
        found: of them, those that were taken to move.
    """

    dynamic: int
    right: int
    moving: int
    found: int

    @property
    def precision(self) -> float:
        """Share of the dynamic anchors that are right; 1 where there are none."""
        return self.right / self.dynamic if self.dynamic else 1.0

    @property
    def recall(self) -> float:
        """Share of the moving anchors that were found; 1 where none moves."""
        return self.found / self.moving if self.moving else 1.0


def dynamic_precision_recall(
    spec: SyntheticSpec,
    before: Scene,
    dynamic: Bool,
    index: int,
    cameras: tuple[Camera, ...],
    filmed: tuple[Camera, ...] | None = None,
) -> MotionScore:
    """Compare a dynamic set with the true motion of the step to frame `index`.

    Args:
        spec: the synthetic clip.
        before: the state that the step starts from.
        dynamic: [N] bool over the anchors of all its levels.
        index: frame of the clip.
        cameras: the training cameras.
        filmed: the same in the clip's own coordinates, where these are not those of the state.

    Raises:
        ValueError: `dynamic` has another length, or `index` lies outside the clip.
    """
    seen, moves, visibly = shown_motion(spec, before, index, cameras, filmed)
    if len(dynamic) != len(seen):
        raise ValueError(f"{len(dynamic)} flags do not fit {len(seen)} anchors")
    right = dynamic & (moves >= _PARTLY * np.maximum(seen, 1e-6))
    moving = (seen >= _SEEN) & (visibly >= _MOSTLY * seen)
    return MotionScore(int(dynamic.sum()), int(right.sum()), int(moving.sum()), int((moving & dynamic).sum()))


def shown_motion(
    spec: SyntheticSpec,
    before: Scene,
    index: int,
    cameras: tuple[Camera, ...],
    filmed: tuple[Camera, ...] | None = None,
) -> tuple[Float64, Float64, Float64]:
    """Pixels that each anchor shows to `cameras`: [N] in all, of surfaces that move, that visibly move.

    Args:
        filmed: as in `dynamic_precision_recall`.
    """
    field = field_of(before)
    rows = torch.from_numpy(np.flatnonzero(np.concatenate([level.alive for level in before.levels])))
    sums = torch.zeros(len(rows), 3)
    for camera, truly in zip(cameras, filmed or cameras, strict=True):
        motion = torch.from_numpy(surface_motion(spec, index, truly))
        maps = torch.stack([torch.ones_like(motion), motion > _ANY, motion >= _VISIBLE], dim=2).float()
        sums += coverage(field, rows, camera, maps)
    shown = np.zeros((len(field), 3))
    shown[rows.numpy()] = sums.double().numpy()
    return shown[:, 0], shown[:, 1], shown[:, 2]
