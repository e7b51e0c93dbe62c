"""The difference of two integer states of one keyframe.

`difference(a, b)` and `apply(a, r)` are inverse to each other for any two states in order of time, and
``apply(apply(a, difference(a, b)), difference(b, c)) == apply(a, difference(a, c))``: predicted, skip and catch-up
packets are one mechanism.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from streamlod.core.arrays import Int16, Int32, Int64, check_array
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, Scene, append_rows

_INT16, _INT32 = np.iinfo(np.int16), np.iinfo(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class LevelResidual:
    """Changes of one level.

    Attributes:
        rows: [n] int64 ascending row numbers that change, all below the row count before.
        position: [n,3] int32 difference in position steps.
        latent: [n,24] int32 difference of latents.
        removed: [m] int64 ascending row numbers that die; they may be among `rows` of no change.
        added: rows appended at the end, with their state after the change.
    """

    rows: Int64
    position: Int32
    latent: Int32
    removed: Int64
    added: AnchorLevel

    def __post_init__(self) -> None:
        check_array("rows", self.rows, (None,), np.int64)
        check_array("position", self.position, (len(self.rows), 3), np.int32)
        check_array("latent", self.latent, (len(self.rows), LATENTS), np.int32)
        check_array("removed", self.removed, (None,), np.int64)

    @property
    def is_empty(self) -> bool:
        """Whether nothing changes."""
        return len(self.rows) == 0 and len(self.removed) == 0 and len(self.added) == 0


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Changes of all levels between two versions under one keyframe."""

    keyframe: int
    from_version: int
    to_version: int
    levels: tuple[LevelResidual, ...]

    @property
    def changed(self) -> int:
        """Anchors that change, are added or go."""
        return sum(len(part.rows) + len(part.added) + len(part.removed) for part in self.levels)


def difference(before: Scene, after: Scene) -> Residual:
    """The residual that turns `before` into `after`.

    Raises:
        ValueError: the scenes belong to different keyframes, or `after` lacks rows of `before`.
    """
    if before.keyframe != after.keyframe:
        raise ValueError(f"states of keyframes {before.keyframe} and {after.keyframe} have no difference")
    pairs = zip(before.levels, after.levels, strict=True)
    return Residual(before.keyframe, before.version, after.version, tuple(_level_difference(a, b) for a, b in pairs))


def apply(scene: Scene, residual: Residual) -> Scene:
    """The state after `residual`.

    Raises:
        ValueError: another keyframe or version, a row that does not exist, or an integer that would overflow.
    """
    if (residual.keyframe, residual.from_version) != (scene.keyframe, scene.version):
        raise ValueError(
            f"residual from version {residual.from_version} of keyframe {residual.keyframe} does not fit "
            f"version {scene.version} of keyframe {scene.keyframe}"
        )
    pairs = zip(scene.levels, residual.levels, strict=True)
    return replace(scene, levels=tuple(apply_level(a, r) for a, r in pairs), version=residual.to_version)


def apply_level(level: AnchorLevel, residual: LevelResidual) -> AnchorLevel:
    """One level after its part of a residual; ValueError as in `apply`."""
    if residual.is_empty:
        return level
    for rows in (residual.rows, residual.removed):
        if len(rows) and (rows[0] < 0 or rows[-1] >= len(level) or (np.diff(rows) <= 0).any()):
            raise ValueError("residual rows must ascend and lie inside the level")
    position, latent, alive = level.position.copy(), level.latent.copy(), level.alive.copy()
    position[residual.rows] = _add(level.position[residual.rows], residual.position, _INT32)
    latent[residual.rows] = _add(level.latent[residual.rows], residual.latent, _INT16)
    alive[residual.removed] = False
    changed = replace(level, position=position, latent=latent, alive=alive)
    return append_rows(changed, residual.added) if len(residual.added) else changed


def _level_difference(before: AnchorLevel, after: AnchorLevel) -> LevelResidual:
    count = len(before)
    if len(after) < count:
        raise ValueError("the later state has fewer rows than the earlier one")
    position = after.position[:count].astype(np.int64) - before.position
    if np.abs(position).max(initial=0) > _INT32.max:
        raise ValueError("a position difference does not fit int32")
    latent = after.latent[:count].astype(np.int32) - before.latent
    rows = np.flatnonzero(position.any(axis=1) | latent.any(axis=1))
    removed = np.flatnonzero(before.alive & ~after.alive[:count])
    added = AnchorLevel(*(getattr(after, name)[count:] for name in AnchorLevel.__slots__))
    return LevelResidual(rows, position[rows].astype(np.int32), latent[rows], removed, added)


def _add(values: Int16 | Int32, delta: Int32, limits: np.iinfo[Any]) -> Int64:
    total = values.astype(np.int64) + delta
    if len(total) and (total.min() < limits.min or total.max() > limits.max):
        raise ValueError("the residual leaves the range of the state's integers")
    return total
