"""The integer update that training one later frame results in, and the residual that it is sent as."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamlod.core.arrays import Bool, Int16, Int32, Int64
from streamlod.core.scene.anchors import LATENTS, AnchorLevel, Scene, empty_level
from streamlod.core.scene.residual import LevelResidual, Residual
from streamlod.core.train.field.convert import level_starts


@dataclass(frozen=True, slots=True, eq=False)
class IntegerUpdate:
    """Changes of n trained anchors, in integer steps.

    Attributes:
        latent: [n,24] int32, position: [n,3] int32: differences to the state before.
        removed: [n] bool, anchors that have become transparent.
        added: new anchors by level, or None for none.
        steps, loss, repaired: figures of the training.
        complete: whether training ran to its end and every change is sent.
    """

    latent: Int32
    position: Int32
    removed: Bool
    added: tuple[AnchorLevel, ...] | None = None
    steps: int = 0
    loss: float = 0.0
    repaired: int = 0
    complete: bool = True

    @property
    def new(self) -> int:
        """Anchors that are added."""
        return 0 if self.added is None else sum(len(level) for level in self.added)


def no_update(anchors: int) -> IntegerUpdate:
    """No change."""
    return IntegerUpdate(
        np.zeros((anchors, LATENTS), np.int32), np.zeros((anchors, 3), np.int32), np.zeros(anchors, np.bool_)
    )


def strongest_changes(update: IntegerUpdate, most: int) -> IntegerUpdate:
    """At most `most` of the changes: the anchors with the largest sums of steps."""
    energy = np.abs(update.latent).sum(axis=1, dtype=np.int64) + np.abs(update.position).sum(axis=1, dtype=np.int64)
    energy[update.removed] = 0  # no change of theirs is sent
    if np.count_nonzero(energy) <= most:
        return update
    kept = np.zeros(len(energy), np.bool_)
    kept[np.argsort(-energy, kind="stable")[:most]] = True
    return replace(
        update,
        latent=np.where(kept[:, None], update.latent, 0).astype(np.int32),
        position=np.where(kept[:, None], update.position, 0).astype(np.int32),
        complete=False,
    )


def residual_of(scene: Scene, rows: Int64, update: IntegerUpdate, version: int) -> Residual:
    """The residual of `scene` to `version` that changes `rows` (numbered over all levels) by `update`."""
    starts = level_starts(scene)
    changed = (update.latent.any(axis=1) | update.position.any(axis=1)) & ~update.removed
    levels = []
    for number, level in enumerate(scene.levels):
        inside = (rows >= starts[number]) & (rows < starts[number + 1])
        own, dead = rows[inside & changed] - starts[number], rows[inside & update.removed] - starts[number]
        latent, position = update.latent[inside & changed], update.position[inside & changed]
        empty = empty_level(level.feature.shape[1], scene.header.gaussians_per_anchor)
        levels.append(
            LevelResidual(
                rows=own,
                position=_within(level.position[own], position),
                latent=_within(level.latent[own], latent),
                removed=dead,
                added=empty if update.added is None else update.added[number],
            )
        )
    return Residual(scene.keyframe, scene.version, version, tuple(levels))


def _within(values: Int16 | Int32, change: Int32) -> Int32:
    """`change`, limited so that `values` stay within their integer type."""
    limits = np.iinfo(values.dtype)
    total = np.clip(values.astype(np.int64) + change, limits.min, limits.max)
    return np.asarray((total - values).astype(np.int32))
