"""Pictures of anchors of which some have moved, so that every motion is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.camera import Camera
from streamlod.core.render.differentiable import rasterise
from streamlod.core.synthetic import SyntheticSpec, cameras
from streamlod.core.train.config import PredictConfig
from streamlod.core.train.field.convert import scene_of
from streamlod.core.train.field.field import Field
from streamlod.core.train.field.rounding import usual_precision
from streamlod.core.train.later_frame.state import KnownPictures, State, fresh_state, no_pictures
from streamlod.core.train.pictures.views import Views
from tests.core.train.fields import random_field

_PLACE = torch.tensor([-0.2, 1.6, 1.0])
RIG = cameras(SyntheticSpec(cameras=4, width=128, height=96))


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """A state, which shows what was filmed, and the pictures of its anchors after `motion` [N,3] world units."""

    state: State
    motion: Tensor
    views: Views

    @property
    def moving(self) -> Tensor:
        """[N] bool."""
        return self.motion.any(dim=1)


def moved_state(shift: tuple[float, float, float] = (0.12, 0.0, 0.06)) -> Moved:
    """Two clouds of anchors before the rig, of which the right one moves by `shift`."""
    field = random_field(300, slots=2, seed=3)
    field.network.output_bias[: field.slots] = 3.0  # opaque
    field = replace(field, position=field.position + _PLACE, feature=3 * field.feature, scaling=field.scaling - 0.3)
    right = field.position[:, 0] > field.position[:, 0].median()
    field = replace(field, position=field.position + right[:, None] * torch.tensor([0.8, 0.0, 0.0]))
    scene = scene_of(field, PredictConfig(), RIG, 30.0, 0, usual_precision(field))
    state = fresh_state(scene, "cpu", no_pictures(RIG, "cpu"))
    gap = field.position[right, 0].min() - 0.4  # rows of a scene are in another order
    motion = (state.field.position[:, :1] > gap) * torch.tensor(shift)
    after = replace(state.field, position=state.field.position + motion)
    filmed, now = (torch.stack([picture(one, camera) for camera in RIG]) for one in (state.field, after))
    return Moved(
        replace(state, known=KnownPictures(filmed, filmed, state.known.shown)),
        motion,
        Views(RIG, now, list(range(len(RIG)))),
    )


def picture(field: Field, camera: Camera) -> Tensor:
    """[H,W,3] what a camera sees of all anchors."""
    with torch.no_grad():
        splats = field.decode(torch.from_numpy(camera.centre).float())
        shown = rasterise(*splats.astuple(), camera=camera, background=torch.full((3,), 0.2), backend="cpu").image
    return shown.clamp(0, 1)
