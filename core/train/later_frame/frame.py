"""One later frame from its pictures to its residual: compare, select, start, train, round, settle.

What a frame does beyond these six stages is done by parts (`core.train.later_frame.part`), whose hooks run in the order
of `TrainConfig.parts`: before the first step and after each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from streamlod.core.arrays import Bool
from streamlod.core.render.backends import Backend
from streamlod.core.scene.residual import Residual, apply
from streamlod.core.train.config import PartSettings, PredictConfig, TrainConfig
from streamlod.core.train.control.frame_budget import FrameBudget, Pace
from streamlod.core.train.control.rate_control import RatePlan
from streamlod.core.train.field.exposure import Exposure
from streamlod.core.train.later_frame.active_tiles import BORDER, mostly_active
from streamlod.core.train.later_frame.comparison import Beginning, Comparison
from streamlod.core.train.later_frame.engine import EngineMaker
from streamlod.core.train.later_frame.part import FramePart
from streamlod.core.train.later_frame.references import renewed_references
from streamlod.core.train.later_frame.state import State
from streamlod.core.train.later_frame.training import FrameTraining, Hooks
from streamlod.core.train.later_frame.update import IntegerUpdate, no_update, residual_of, strongest_changes
from streamlod.core.train.motion.cues import cue_of
from streamlod.core.train.motion.masks import change_masks
from streamlod.core.train.motion.scores import Observation
from streamlod.core.train.pictures.boxes import tiles_near
from streamlod.core.train.pictures.views import Views
from streamlod.core.train.progress import Stopwatch

_AFTER_TRAINING = ("round", "settle", "encode")  # stages that a frame's budget keeps time for


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """What a frame may spend, and by what it is trained.

    Attributes:
        config: of the stream. plan: of the rate control.
        backend: of the rasteriser. engine_of: makes the engine of a frame. exposure: of the cameras.
        first_count: anchors of the first frame since the start.
        budget: of time. watch: counts the time of each stage.
    """

    config: TrainConfig
    plan: RatePlan
    backend: Backend
    engine_of: EngineMaker
    exposure: Exposure
    first_count: int
    budget: FrameBudget
    watch: Stopwatch

    def allows(self, stage: str) -> bool:
        """Whether there is time for a stage before the stages after training."""
        return self.budget.allows(stage, *_AFTER_TRAINING)

    def pace(self, steps: int) -> Pace:
        """The pace of so many steps, before those stages."""
        return self.budget.pace(steps, *_AFTER_TRAINING)


@dataclass(frozen=True, slots=True, eq=False)
class LaterFrame:
    """A trained frame: the state after it, the residual that leads there, and the dynamic set [N] bool."""

    state: State
    residual: Residual
    update: IntegerUpdate
    dynamic: Bool


def train_later_frame(state: State, views: Views, index: int, means: Means) -> LaterFrame:
    """Train frame `index` from `state`, whose references and pictures of every usable camera are known."""
    watch, plan = means.watch, means.plan
    config = plan.applied(means.config.predict)
    with watch.stage("compare"):
        masks = change_masks(state.known.references, state.known.filmed, views, config.noise_floor)
        pictures = Comparison(views, masks, state.known)
        coarse = pictures.halved() if pictures.is_large and config.half_size_until > 0 else pictures
    with watch.stage("partition"):
        dynamic, renewed = _selected(state, coarse, index, config, means)
        dynamic = _worth_training(state, dynamic, pictures, means)
    rows = torch.from_numpy(np.flatnonzero(dynamic)).to(state.field.feature.device)
    update, training = no_update(0), None
    if len(rows):
        seen = Beginning(state, rows, pictures, coarse, means.config, means.first_count, plan.most_new)
        hooks = started(means.config.parts, seen, means.allows, watch)
        with watch.stage("train"):
            useful = _useful(coarse, config)
            training = FrameTraining(seen, hooks, means.exposure, useful, means.engine_of, config)
            generator = torch.Generator().manual_seed(means.config.seed + index)
            update = training.run(generator, means.pace)
    with watch.stage("round"):
        update = strongest_changes(update, plan.most_changes_beside(update.new))
        # what had no time or no bytes counts as changed in the next frame
        done = update.complete and not plan.strained
        residual = residual_of(state.scene, rows.cpu().numpy(), update, index)
        after = state.after(residual, apply(state.scene, residual), dynamic)
    with watch.stage("settle"):
        shown = state.known.shown
        if training is not None:
            drawn = np.flatnonzero(after.trained & after.alive.cpu().numpy())
            shown = training.show(after.field, torch.from_numpy(drawn).to(rows.device))
        if renewed:
            after = renewed_references(after, state, views, masks, shown, done=done)
    known = replace(after.known, shown=shown, filmed=views.or_before(state.known.filmed))
    return LaterFrame(replace(after, known=known), residual, update, dynamic)


def _selected(state: State, pictures: Comparison, index: int, config: PredictConfig, means: Means) -> tuple[Bool, bool]:
    """[N] what to train, and whether that was found anew: where it is due and there is time; as before otherwise."""
    alive = state.alive
    previous = state.trained & alive.cpu().numpy()
    if not means.allows("partition") or (index % config.partition_interval and previous.any()):
        return previous, False
    seen = Observation(
        field=state.field,
        canonical=state.canonical,
        alive=alive,
        views=pictures.views,
        references=pictures.known.references,
        masks=pictures.masks,
        backend=means.backend,
    )
    return cue_of(config.cue).partition(seen, config.posterior), True


def _worth_training(state: State, dynamic: Bool, pictures: Comparison, means: Means) -> Bool:
    """[N] those of the `dynamic` ones that mostly show what changed; all where the cue looks at still pixels too."""
    views, masks = pictures.views, pictures.masks
    changed = [number for number in views.usable if masks[number].any()]
    if means.backend != "cpu" or not cue_of(means.config.predict.cue).only_changed_views or not changed:
        return dynamic
    active = {number: tiles_near(masks[number].numpy(), BORDER) for number in changed}
    rows, chosen = np.flatnonzero(dynamic), np.zeros_like(dynamic)
    chosen[rows] = mostly_active(state.field, torch.from_numpy(rows), views.cameras, active)
    return chosen


def started(
    parts: Sequence[PartSettings], seen: Beginning, allows: Callable[[str], bool], watch: Stopwatch
) -> list[Hooks]:
    """Hooks of the parts for which there is time."""
    hooks = list[Hooks]()
    for part in parts:
        assert isinstance(part, FramePart)
        if not part.is_costly or allows(part.name):
            with watch.stage(part.name):
                hooks.append(part.begin(seen))
    return hooks


def _useful(pictures: Comparison, config: PredictConfig) -> list[int]:
    """Cameras to train on: where the cue asks for it, those in which pixels changed, those that see most change first.

    All usable ones if only one is left: trained on its picture alone, anchors would get worse for every other camera.
    """
    views = pictures.views
    if not cue_of(config.cue).only_changed_views:
        return views.usable
    order = torch.argsort(pictures.differences(), descending=True, stable=True).tolist()
    usable = [number for number in order if number in views.usable]
    changed = [number for number in usable if pictures.masks[number].any()]
    return changed if len(changed) > 1 else usable
