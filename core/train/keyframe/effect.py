"""How much of the pictures each anchor makes: those without which they would look almost the same need not be sent.

A picture is affine in the opacity of each Gaussian while the others stay, so what an anchor's absence changes is known
exactly from the gradients of the picture's values by its opacity, without drawing the picture anew. What may go is
relative to the error that is there anyway: a scene that fits well keeps fainter anchors than one that does not.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from streamlod.core.train.keyframe.precision import signed_gradients

_PROBES = 24  # backward passes, at least one a view: fewer order anchors worse, sixteen a view hardly better than four
_HALVINGS = 8  # of the anchors, until what may go is known to a 256th of them


def anchor_effects(
    anchors: int, draw: Callable[[int, tuple[Tensor, ...]], Tensor], views: list[int], seed: int, device: torch.device
) -> Tensor:
    """[N] squared error that leaving out each anchor alone would add, in the mean of the views; an estimate.

    Args:
        draw: the picture [H,W,3] of a view, in any unit, whose opacities are multiplied by the [N] shares that it is
            given of the anchors, in a tuple.
        views: at least one. seed: of the signs (`core.train.keyframe.precision.signed_gradients`).
    """
    times = max(1, round(_PROBES / len(views)))
    total = torch.zeros(anchors, device=device)
    present = torch.ones(anchors, device=device)
    for (gradient,) in signed_gradients((present,), draw, views * times, seed):
        total += gradient.square()
    return total / (times * len(views))


def dispensable(effects: Tensor, budget: float, added: Callable[[Tensor], float]) -> Tensor:
    """[N] bool: the anchors of least effect, as many as may go together; some always stay.

    Anchors that hide one another have little effect each, and much together. So how many may go is asked of pictures.

    Args:
        effects: [N] of each alone.
        budget: of what `added` may tell.
        added: the squared error that is added where anchors have these [N] shares of their opacity, 0 or 1.
    """
    order = effects.argsort(stable=True)
    present = torch.ones_like(effects)
    low, high = 0, len(effects)
    for _ in range(_HALVINGS):
        middle = (low + high) // 2
        present[order[:middle]], present[order[middle:]] = 0.0, 1.0
        low, high = (middle, high) if added(present) <= budget else (low, middle)
    gone = torch.zeros_like(effects, dtype=torch.bool)
    gone[order[:low]] = True
    return gone
