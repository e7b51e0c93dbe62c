"""What the next frame starts from: the decoder's integers, and what the trainer keeps beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool
from streamlod.core.camera import Camera
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import Residual
from streamlod.core.train.field.convert import field_of, level_starts
from streamlod.core.train.field.field import Field


@dataclass(frozen=True, slots=True, eq=False)
class KnownPictures:
    """Pictures [C,H,W,3] of C cameras that are kept beside a state; NaN for cameras of which none is known.

    Attributes:
        references: what new ones are compared with: what was filmed when a change was last accepted, or what the state
            shows where training of that goes on.
        filmed: those of the latest frame, of a camera that was not there its last one.
        shown: what the cameras would film of the state.
    """

    references: Tensor
    filmed: Tensor
    shown: Tensor


def no_pictures(cameras: tuple[Camera, ...], device: str) -> KnownPictures:
    """Nothing is known of any of `cameras`."""
    nothing = torch.full((len(cameras), cameras[0].height, cameras[0].width, 3), torch.nan, device=device)
    return KnownPictures(nothing, nothing, nothing)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A stream after a frame.

    Attributes:
        scene: the decoder's integer state; field: the same, dequantised.
        canonical: the keyframe's field, for the paper's motion cue.
        known: pictures of its cameras.
        trained: [N] bool, the anchors that the latest frame trained.
    """

    scene: Scene
    field: Field
    canonical: Field
    known: KnownPictures
    trained: Bool

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

    def after(self, residual: Residual, scene: Scene, trained: Bool) -> State:
        """The state that `residual` led to by training `trained` [N], dequantised as decoders do.

        With new anchors, rows of finer levels move up, and the new ones count as dynamic.
        """
        after = replace(self, scene=scene, trained=trained)
        if not any(len(part.rows) + len(part.added) for part in residual.levels):
            return after
        device, starts = str(self.field.feature.device), level_starts(self.scene)
        origins = []  # the rows before, -1 for new ones
        for number, part in enumerate(residual.levels):
            origins += [np.arange(starts[number], starts[number + 1]), np.full(len(part.added), -1)]
        origin = np.concatenate(origins)
        field = replace(field_of(scene).to(device), by_distance=self.field.by_distance)
        new = torch.from_numpy(np.flatnonzero(origin < 0)).to(device)
        known = torch.from_numpy(np.maximum(origin, 0)).to(device)
        return replace(
            after,
            field=field,
            canonical=self.canonical.with_rows(known).with_values(new, field),
            trained=(origin < 0) | trained[np.maximum(origin, 0)],
        )


def fresh_state(scene: Scene, device: str, known: KnownPictures, *, by_distance: bool = False) -> State:
    """The state of a keyframe; `by_distance` as in `Field`."""
    field = replace(field_of(scene).to(device), by_distance=by_distance)
    return State(scene, field, field, known, np.zeros(len(field), np.bool_))
