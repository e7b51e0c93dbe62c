"""What the next pictures are compared with, to see what has changed.

A change is trained until that helps no more: a floor that a ball has rolled over is not as it should be after the few
steps of one frame, and would never be trained again if its picture counted as reached.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.train.later_frame.state import State
from streamlod.core.train.pictures.boxes import around
from streamlod.core.train.pictures.views import Views

_NEIGHBOURHOOD = 5  # pixels
_GAIN, _GAIN_CUT_SHORT = 0.1, 0.01  # of the error that a frame's training must take off to go on


def renewed_references(after: State, before: State, views: Views, masks: Tensor, shown: Tensor, *, done: bool) -> State:
    """`after` with the pictures that the next ones are compared with: renewed in changed pixels, `masks` [C,H,W].

    There it is the picture that was filmed; but where training still gets on, what the state shows now, so that what is
    missing of the change counts as changed again.

    Args:
        before: the state before the frame. shown: [C,H,W,3] what the one after it shows, NaN where that is not known.
        done: nothing was cut short.
    """
    if not masks.any():
        return after
    references = after.known.references.clone()
    least_gain = _GAIN if done else _GAIN_CUT_SHORT
    for number in torch.nonzero(masks.any(dim=2).any(dim=1))[:, 0].tolist():
        part = (number, *around(masks[number], _NEIGHBOURHOOD // 2))
        mask, target, now = masks[part][..., None], views.targets[part], shown[part].clamp(0, 1)
        ends = stagnant(target[None], before.known.shown[part].clamp(0, 1)[None], now[None], least_gain)[0, ..., None]
        reached = torch.where(ends, target, now)
        reached = torch.where(now.isnan(), target if done else references[part], reached)
        references[part] = torch.where(mask, reached, references[part])
    return replace(after, known=replace(after.known, references=references))


def as_filmed(state: State, views: Views, numbers: list[int]) -> State:
    """`state` with the pictures of the cameras `numbers` as those that the next ones are compared with."""
    references, filmed = state.known.references.clone(), state.known.filmed.clone()
    references[numbers] = filmed[numbers] = views.targets[numbers]
    return replace(state, known=replace(state.known, references=references, filmed=filmed))


def stagnant(targets: Tensor, before: Tensor, now: Tensor, least_gain: float) -> Tensor:
    """[C,H,W] bool: pixels round which a frame's training took less than `least_gain` of the absolute error off.

    Args:
        targets: [C,H,W,3] what it should show. before, now: likewise, what was shown before and after it, NaN where
            that is not known; there nothing is stagnant.
    """

    def error(shown: Tensor) -> Tensor:
        difference = (targets - shown).abs().amax(dim=3)[:, None]
        for window in ((_NEIGHBOURHOOD, 1), (1, _NEIGHBOURHOOD)):  # one after the other is less work
            room = (window[0] // 2, window[1] // 2)
            difference = functional.avg_pool2d(difference, window, 1, room, count_include_pad=False)
        return difference[:, 0]

    return error(now) > (1 - least_gain) * error(before)
