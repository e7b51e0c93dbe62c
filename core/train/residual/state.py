"""What the next frame starts from: the decoder's integers, and what the trainer keeps beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Float32
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import anchor_positions, dequantise
from streamlod.core.scene.residual import Residual
from streamlod.core.train.field.convert import field_of, level_starts
from streamlod.core.train.field.field import Field
from streamlod.core.train.residual.update import IntegerUpdate


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Of a stream after a frame.

    Attributes:
        scene: the decoder's integer state; field: the same, dequantised.
        canonical: the keyframe's field, for the paper's motion cue.
        references: [C,H,W,3] pictures that new ones are compared with: what was filmed when a change was last
            accepted, or what the state shows where training of that goes on; NaN for cameras not seen yet; None after
            a resume.
        filmed: [C,H,W,3] what was filmed when a change was last accepted, also where training goes on; None: the same
            as `references`.
        shown: [C,H,W,3] what the cameras would film of the state, NaN where that is not known; None likewise.
        trained: [N] bool, the anchors that the latest frame trained.
        change: [N,27] of the latest frame, latents and positions in steps; None for zeros.
        start: [N,27] likewise, where training of the next frame begins.
    """

    scene: Scene
    field: Field
    canonical: Field
    references: Tensor | None
    shown: Tensor | None
    trained: Bool
    change: Tensor | None = None
    start: Tensor | None = None
    filmed: Tensor | None = None

    @property
    def alive(self) -> Tensor:
        """[N] bool, on the field's device."""
        alive = np.concatenate([level.alive for level in self.scene.levels])
        return torch.from_numpy(alive).to(self.field.feature.device)

    @property
    def is_untouched(self) -> bool:
        """Whether the keyframe's anchors are all alive and as they were."""
        if not bool(self.alive.all()) or len(self.field) != len(self.canonical):
            return False
        names = ("feature", "offset", "position")
        return all(torch.equal(getattr(self.field, name), getattr(self.canonical, name)) for name in names)

    def after(
        self,
        residual: Residual,
        scene: Scene,
        trained: Bool,
        rows: Tensor,
        update: IntegerUpdate,
        start: Float32,
    ) -> State:
        """The state that `residual` led to; changed rows are dequantised again, as the decoder does it.

        Args:
            trained: [N] bool. rows: [n] their numbers, with their `update` and where to `start` [n,27] next.
        """
        if any(len(part.added) for part in residual.levels):
            return self._with_added_rows(residual, scene, trained, rows, update, start)
        field, starts = self.field, level_starts(scene)
        device = field.feature.device
        feature, offset, position = field.feature.clone(), field.offset.clone(), field.position.clone()
        for number, (level, part) in enumerate(zip(scene.levels, residual.levels, strict=True)):
            if len(part.rows) == 0:
                continue
            changed = torch.from_numpy(part.rows + starts[number]).to(device)
            new_feature, new_offset, _ = dequantise(scene.header, scene.weights, level, part.rows)
            feature[changed] = torch.from_numpy(new_feature).to(device)
            offset[changed] = torch.from_numpy(new_offset).to(device)
            position[changed] = torch.from_numpy(anchor_positions(scene.header, number, level)[part.rows]).to(device)
        field = replace(field, feature=feature, offset=offset, position=position)
        changes, starts_at = torch.zeros(2, len(field), start.shape[1], device=device)
        changes[rows], starts_at[rows] = torch.from_numpy(update.sent).to(device), torch.from_numpy(start).to(device)
        return replace(
            self,
            scene=scene,
            field=field,
            trained=trained,
            change=changes,
            start=starts_at,
        )

    def _with_added_rows(
        self,
        residual: Residual,
        scene: Scene,
        trained: Bool,
        rows: Tensor,
        update: IntegerUpdate,
        start: Float32,
    ) -> State:
        """As `after`, where anchors were added: rows of finer levels move up; new ones count as dynamic."""
        device = str(self.field.feature.device)
        before, origins = level_starts(self.scene), []
        for number, part in enumerate(residual.levels):
            origins += [np.arange(before[number], before[number + 1]), np.full(len(part.added), -1)]
        origin = np.concatenate(origins)
        field = replace(field_of(scene).to(device), by_distance=self.field.by_distance)
        new = torch.from_numpy(np.flatnonzero(origin < 0)).to(device)
        known = torch.from_numpy(np.maximum(origin, 0)).to(device)
        canonical = self.canonical.with_rows(known).with_values(new, field)
        is_known = torch.from_numpy(origin >= 0).to(device)[:, None]
        changes, starts_at = torch.zeros(2, len(self.field), start.shape[1], device=device)
        changes[rows], starts_at[rows] = torch.from_numpy(update.sent).to(device), torch.from_numpy(start).to(device)
        return replace(
            self,
            scene=scene,
            field=field,
            canonical=canonical,
            trained=(origin < 0) | trained[np.maximum(origin, 0)],
            change=changes[known] * is_known,
            start=starts_at[known] * is_known,
        )


def fresh_state(
    scene: Scene,
    device: str,
    references: Tensor | None = None,
    shown: Tensor | None = None,
    *,
    by_distance: bool = False,
) -> State:
    """The state of a keyframe; `by_distance` as in `Field`."""
    field = replace(field_of(scene).to(device), by_distance=by_distance)
    return State(scene, field, field, references, shown, np.zeros(len(field), np.bool_))
