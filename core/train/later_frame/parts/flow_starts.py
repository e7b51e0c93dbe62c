"""Where training of a later frame begins: search before descent.

Where something went farther than its Gaussians reach, its gradient points anywhere. Optical flow in all cameras says
how far anchors went in space; but flow bleeds over the edges of what moves, so both starts are rendered, and each
anchor begins where the pixels that it shows are nearer to the new pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from streamlod.core.train.field.decode import Splats
from streamlod.core.train.later_frame.comparison import Comparison
from streamlod.core.train.later_frame.state import State
from streamlod.core.train.later_frame.training import FrameTraining, Hooks
from streamlod.core.train.motion.optical_flow import anchor_flow
from streamlod.core.train.motion.scene_flow import flow_error, projection_jacobians, scene_flow

_LEAST_GAIN = 0.2  # pixels by which a guess must fit the flow better than rest
_WORTH = 0.1  # of summed absolute errors, in units of [0, 1], that a guess must mend
_MAX_STEPS = 400.0  # no motion is longer: one wild flow must not throw an anchor out of the scene


@dataclass(frozen=True, slots=True, eq=False)
class Searching(Hooks):
    """Lets each anchor begin at rest or at its `guess` [n,3] in steps, whichever shows more of what was filmed."""

    guess: Tensor

    def ready(self, training: FrameTraining) -> None:
        training.anchors.begin_at(better_starts(self.guess, training))


def guessed_positions(state: State, rows: Tensor, pictures: Comparison, least: float) -> Tensor:
    """[n,3] steps that optical flow says the trained anchors `rows` [n] go; zeros where it says nothing better.

    Args:
        pictures: in which flow is looked for.
        least: of their pixels that an anchor must go.
    """
    found = anchor_flow(state.field, rows, pictures.known.filmed, pictures.views, pictures.masks, least)
    going = found.seen.any(dim=0)
    guess = torch.zeros(len(rows), 3, device=rows.device)
    if not going.any():
        return guess
    found, position = found.of(going), state.field.position[rows[going]]
    steps = torch.from_numpy(state.scene.header.position_steps).to(position)
    step = steps[state.field.level[rows[going]]][:, None]
    jacobian = projection_jacobians(position, pictures.views.cameras)
    motion = scene_flow(jacobian, found)
    at_rest = flow_error(torch.zeros_like(motion), jacobian, found)
    better = at_rest - flow_error(motion, jacobian, found) > _LEAST_GAIN
    guess[going] = torch.where(better[:, None], (motion / step).clamp(-_MAX_STEPS, _MAX_STEPS), 0.0)
    return guess


def better_starts(guess: Tensor, training: FrameTraining) -> Tensor:
    """[n,3] of rest and `guess` [n,3], for each anchor the start that shows more of what was filmed."""
    rest, differs = torch.zeros_like(guess), guess.any(dim=1)
    if not differs.any():
        return rest
    worth = torch.zeros(len(guess), device=guess.device)
    for number in training.numbers:
        places = [_tinted(training.splats_at(number, start)) for start in (rest, guess)]
        pictures, target = training.engine.draw_two(number, *places), training.engine.target(number)
        error, guessed = ((picture.detach() - target).abs().sum(dim=2) for picture in pictures)
        for picture, splats in zip(pictures, places, strict=True):
            worth += _shown(picture, splats.colours, error - guessed, len(guess))
    return torch.where((differs & (worth > _WORTH))[:, None], guess, rest)


def _shown(picture: Tensor, colours: Tensor, weights: Tensor, anchors: int) -> Tensor:
    """[n] sum over the pixels of `weights` [H,W] times the blending weight that each anchor has in `picture` [H,W,3].

    Args:
        colours: [G,3] of the anchors' Gaussians, by which the picture can be differentiated once.
    """
    upstream = torch.zeros_like(picture)
    upstream[..., 0] = weights
    (gradient,) = torch.autograd.grad(picture, colours, upstream)
    return gradient[:, 0].reshape(anchors, -1).sum(dim=1)


def _tinted(splats: Splats) -> Splats:
    """`splats` whose colours alone are differentiated."""
    return replace(splats.detached(), colours=splats.colours.detach().requires_grad_())
