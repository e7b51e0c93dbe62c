"""The dynamic set against true motion, where a clip comes with its truth."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from core.anchors import Scene
from core.arrays import Bool, Float64
from core.data.files import read_json
from core.data.synthetic import SyntheticSpec, is_dynamic
from core.errors import InputError
from core.expand import anchor_positions, expand_slots
from core.residual import Residual

_REACH = 0.03  # metres from a surface at least
_TRANSPARENT = 1 / 255  # opacity up to which nothing is drawn
_SPEC = Path("ground_truth") / "spec.json"


@dataclass(frozen=True, slots=True)
class MotionScore:
    """How well the anchors that a residual changes agree with those that truly move.

    Attributes:
        changed: anchors that the residual changes or removes.
        moving: anchors that stand for a surface that moves, as far as they are drawn or change.
        both: anchors that are both.
    """

    changed: int
    moving: int
    both: int

    @property
    def precision(self) -> float:
        """Share of the changed anchors that truly move; 1 where none changed."""
        return self.both / self.changed if self.changed else 1.0

    @property
    def recall(self) -> float:
        """Share of the moving anchors that changed; 1 where none moves."""
        return self.both / self.moving if self.moving else 1.0


def dynamic_precision_recall(spec: SyntheticSpec, before: Scene, residual: Residual, index: int) -> MotionScore:
    """Compare a residual's rows with the true motion of the step to frame `index`.

    Args:
        spec: the synthetic clip.
        before: the state that the residual changes; its anchors' positions are asked about.
        index: frame of the clip after the residual.
    """
    changed = moving = both = 0
    viewpoint = np.mean([camera.centre for camera in before.header.cameras], axis=0)
    for number, (level, part) in enumerate(zip(before.levels, residual.levels, strict=True)):
        touched = np.zeros(len(level), np.bool_)
        touched[part.rows] = True
        touched[part.removed] = True
        places = anchor_positions(before.header, number, level)
        reach = max(_REACH, before.header.octree.cell(number) / 2)  # an anchor stands for its cell
        truth = is_dynamic(spec, places, index, tolerance=reach) & (_drawn(before, number, viewpoint) | touched)
        changed += int(touched.sum())
        moving += int(truth.sum())
        both += int((touched & truth).sum())
    return MotionScore(changed, moving, both)


def _drawn(scene: Scene, number: int, viewpoint: Float64) -> Bool:
    """[N] whether any Gaussian of an anchor of level `number` is drawn for a camera at `viewpoint` [3]."""
    level = scene.levels[number]
    cloud = expand_slots(scene.header, scene.weights, number, level, np.arange(len(level)), viewpoint)
    opacity = cloud.opacities.reshape(len(level), -1).max(axis=1, initial=0)
    return np.asarray(level.alive & (opacity > _TRANSPARENT))


def read_spec(data: Path) -> SyntheticSpec | None:
    """The description of a synthetic clip in folder `data`, None for any other recording.

    Raises:
        InputError: a description that is none.
    """
    path = data / _SPEC
    if not path.is_file():
        return None
    value = read_json(path).get("spec")
    known: dict[str, type[Any]] = {field.name: type(field.default) for field in fields(SyntheticSpec)}
    if not isinstance(value, dict) or set(value) != set(known):
        raise InputError(path, "does not describe a synthetic clip")
    if not all(isinstance(value[name], int | float) for name in known):
        raise InputError(path, "holds a value that is no number")
    return SyntheticSpec(**{name: kind(value[name]) for name, kind in known.items()})
