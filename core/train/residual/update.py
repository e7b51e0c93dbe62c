"""What one later frame's training found, in integers, and the residual that it becomes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from core.arrays import Bool, Float32, Int16, Int32, Int64
from core.scene.anchors import LATENTS, AnchorLevel, Scene, empty_level
from core.scene.residual import LevelResidual, Residual
from core.train.field.convert import level_starts

_LARGEST_REST = 2.0  # quanta; more is no rest but a change that could not be sent
_FURTHEST = 64.0  # quanta that a change may be continued by: a wild one must not throw an anchor out of the scene


@dataclass(frozen=True, slots=True, eq=False)
class Quanta:
    """What one frame's training found, in integers.

    Attributes:
        latent: [n,24] int32, position: [n,3] int32: differences of the n dynamic anchors.
        removed: [n] bool, those that have become transparent.
        added: new anchors by level, or None for none.
        steps, loss, repaired: figures of the training.
        complete: whether all that was planned was trained, and nothing held back.
        wanted: [n,27] float32 latents and positions before rounding, or None for zeros.
    """

    latent: Int32
    position: Int32
    removed: Bool
    added: tuple[AnchorLevel, ...] | None = None
    steps: int = 0
    loss: float = 0.0
    repaired: int = 0
    complete: bool = True
    wanted: Float32 | None = None

    @property
    def sent(self) -> Float32:
        """[n,27] the integers of latents and positions."""
        return np.concatenate([self.latent, self.position], axis=1).astype(np.float32)

    @property
    def rest(self) -> Float32:
        """[n,27] what rounding, and what held changes back, left undone."""
        sent = self.sent
        if self.wanted is None:
            return np.zeros_like(sent)
        return np.asarray(np.clip(self.wanted - sent, -_LARGEST_REST, _LARGEST_REST))

    def continued(self, share: float, before: Float32, *, done: bool) -> Float32:
        """[n,27] where the next frame's training begins: `share` of this change, for what moves mostly goes on.

        Only where the change `before` [n,27] pointed the same way: a flash is over in the next frame.

        Args:
            done: nothing was cut short; otherwise the rest is added.
        """
        sent = self.sent
        onwards = np.clip(np.float32(share) * sent * (sent * before > 0), -_FURTHEST, _FURTHEST)
        return np.asarray(onwards if done else onwards + self.rest)


def no_quanta(anchors: int) -> Quanta:
    """Nothing changes."""
    return Quanta(np.zeros((anchors, LATENTS), np.int32), np.zeros((anchors, 3), np.int32), np.zeros(anchors, np.bool_))


def strongest_changes(quanta: Quanta, most: int, first: Bool) -> Quanta:
    """At most `most` of the changes: those of the anchors `first` [n] before others, and those of most quanta first."""
    energy = np.abs(quanta.latent).sum(axis=1, dtype=np.int64) + np.abs(quanta.position).sum(axis=1, dtype=np.int64)
    if np.count_nonzero(energy) <= most:
        return quanta
    kept = np.zeros(len(energy), np.bool_)
    kept[np.lexsort((-energy, ~first | (energy == 0)))[:most]] = True
    return replace(
        quanta,
        latent=np.where(kept[:, None], quanta.latent, 0).astype(np.int32),
        position=np.where(kept[:, None], quanta.position, 0).astype(np.int32),
        complete=False,
    )


def residual_of(scene: Scene, rows: Int64, quanta: Quanta, version: int) -> Residual:
    """The residual of `scene` to `version` that `quanta` of `rows` (numbered over all levels) stand for."""
    starts = level_starts(scene)
    changed = (quanta.latent.any(axis=1) | quanta.position.any(axis=1)) & ~quanta.removed
    levels = []
    for number, level in enumerate(scene.levels):
        inside = (rows >= starts[number]) & (rows < starts[number + 1])
        own, dead = rows[inside & changed] - starts[number], rows[inside & quanta.removed] - starts[number]
        latent, position = quanta.latent[inside & changed], quanta.position[inside & changed]
        empty = empty_level(level.feature.shape[1], scene.header.gaussians_per_anchor)
        levels.append(
            LevelResidual(
                rows=own,
                position=_within(level.position[own], position),
                latent=_within(level.latent[own], latent),
                removed=dead,
                added=empty if quanta.added is None else quanta.added[number],
            )
        )
    return Residual(scene.keyframe, scene.version, version, tuple(levels))


def _within(values: Int16 | Int32, change: Int32) -> Int32:
    """`change` of `values`, as far as their integers reach."""
    limits = np.iinfo(values.dtype)
    total = np.clip(values.astype(np.int64) + change, limits.min, limits.max)
    return np.asarray((total - values).astype(np.int32))
