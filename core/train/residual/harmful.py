"""Which anchors the pictures of a frame would be better without.

What moves fast sheds anchors: they fall behind, show its colours on what it uncovers, and their gradients lead nowhere.
An anchor by itself may also be wrong for one frame only, before training has caught up with it; so it has to be harmful
in several frames in a row, and to have gone far in the last one: what stands still is trained by and by.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Bool, Float32, Int64
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.keyframe.precision import signed_gradients

_CELLS = 0.5  # width, in motion cells, of the neighbourhoods of which one anchor goes at a time


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Of n anchors.

    Attributes:
        frames: [n] in a row, up to this one, in which the pictures would have been better without the anchor.
        gone: [n] bool, those that are removed.
    """

    frames: Int64
    gone: Bool


def nothing_judged(anchors: int) -> Judgement:
    """None is harmful, and none goes."""
    return Judgement(np.zeros(anchors, np.int64), np.zeros(anchors, np.bool_))


def judged(
    change: Float32, before: Int64, far: Bool, position: Float32, motion_cell: float, least: int, most: int
) -> Judgement:
    """Remove the most harmful anchor of each neighbourhood; what it has hidden then decides about the next.

    Args:
        change: [n] as `error_without` gives it. before: [n] as `Judgement.frames` of the frame before.
        far: [n] anchors that have gone far. position: [n,3] where they are.
        least: frames in a row. most: anchors that may go.
    """
    frames = np.where(change < 0, before + 1, 0)
    asked = np.flatnonzero((frames >= least) & far)
    worst_first = asked[np.argsort(change[asked], kind="stable")]
    cells = np.floor(position[worst_first] / (_CELLS * motion_cell)).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    gone = np.zeros(len(change), np.bool_)
    gone[worst_first[np.sort(first)[:most]]] = True
    return Judgement(frames, gone)


def error_without(
    splats_of: Callable[[int], Splats],
    draw: Callable[[int, Splats], Tensor],
    targets: Tensor,
    numbers: Iterable[int],
    anchors: int,
    seed: int,
) -> Tensor:
    """[n] by how much the squared error, summed over all pictures, would grow without each of n `anchors`; an estimate.

    A picture is linear in the opacity of one Gaussian. So with r the error and d what the anchor adds to the picture,
    the error without it is |r - d|^2 = |r|^2 - 2 r.d + |d|^2. One backward pass gives r.d of all anchors, and one with
    random signs (Hutchinson's estimator) an unbiased estimate of |d|^2. Gaussians of one anchor count as if they did
    not hide each other.

    Args:
        splats_of: the Gaussians of all anchors, as many for each, for a camera's number.
        draw: [H,W,3] what a camera sees of them, differentiable by their opacities.
        targets: [C,H,W,3] the pictures as they should be. numbers: of the cameras to ask.
    """
    change = torch.zeros(anchors, device=targets.device)
    for number in numbers:
        splats = splats_of(number).detached()

        def picture(number: int, leaves: tuple[Tensor, ...], splats: Splats = splats) -> Tensor:
            return draw(number, replace(splats, opacities=leaves[0]))

        opacities = splats.opacities.clone().requires_grad_()
        image = picture(number, (opacities,))
        (pull,) = torch.autograd.grad(image, opacities, 2 * (image.detach() - targets[number]))
        ((signed,),) = signed_gradients((opacities,), picture, [number], seed + number)
        shown = splats.opacities.clamp(min=0)
        added, spread = ((shown * part).reshape(anchors, -1).sum(dim=1) for part in (pull, signed))
        change += spread.square() - added
    return change.nan_to_num(0.0, 0.0, 0.0)
