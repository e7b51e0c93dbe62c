"""Which anchors a later frame sends anew, with all their numbers: a rolling refresh, as video codecs have it.

Residuals change features and offsets along fixed directions and never sizes, so what turns, bends and comes out of the
shade drifts away from what its Gaussians can show. A refresh keyframe mends that for all anchors at once; this mends it
for some in every frame, where it is needed most.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, replace

import numpy as np
import torch
from torch import Tensor

from streamlod.core.train.field.field import Field
from streamlod.core.train.field.learned import ROW_PARAMETERS
from streamlod.core.train.residual.added_anchors import RATES

_LEAST_ANCHORS = 16  # fewer take fewer bytes than the tables of their chunks in the packet


def rewritten_anchors(far: Tensor, most: int, least_pull: float, pull: Callable[[], Tensor]) -> Tensor:
    """[m] ascending: those of the anchors that have gone `far` [n] bool whose pull is above `least_pull`.

    Args:
        most: m at most, those that pull hardest. None if fewer than 16 are left: the tables of their chunks would take
            more bytes than they do.
        least_pull: in units of `pull_of`.
        pull: gives `pull_of` the anchors; asked only where it is needed.
    """
    none = torch.zeros(0, dtype=torch.int64, device=far.device)
    most = min(most, int(far.sum()))
    if most < _LEAST_ANCHORS:
        return none
    strongest = torch.where(far, pull(), 0.0).topk(most)
    chosen = strongest.indices[strongest.values > least_pull]
    return none if len(chosen) < _LEAST_ANCHORS else chosen.sort().values


def pull_of(field: Field, loss_of: Callable[[int, Field], Tensor], numbers: Iterable[int]) -> Tensor:
    """[n] by how much one step of an anchor's features, offsets and sizes would lower the loss, to the first order.

    Adam's steps are as large as its rates, whatever the gradient, so that is the sum of the gradients' sizes times the
    rates, as these are when a frame begins.

    Args:
        loss_of: of a camera's picture, of its number and the anchors. numbers: of the cameras.
    """
    leaves = {name: getattr(field, name).detach().clone().requires_grad_() for name in ROW_PARAMETERS}
    for number in numbers:
        loss_of(number, replace(field, **leaves)).backward()  # type: ignore[no-untyped-call]
    pulls = [
        RATES[name] * leaf.grad.flatten(1).abs().sum(dim=1) for name, leaf in leaves.items() if leaf.grad is not None
    ]
    return torch.stack(pulls).sum(dim=0).nan_to_num(0.0, 0.0, 0.0)


def values_of(field: Field, rows: Tensor) -> dict[str, Tensor]:
    """The seven arrays of anchors `rows` [m] of `field`, on the nodes that are nearest to where they are now.

    Nodes lie among those of all anchors of the field, as a keyframe cannot hold a grid that a lost anchor stretches.
    """
    chosen, octree = field.with_rows(rows), field.octree
    position, level = chosen.position.double().nan_to_num(0.0).cpu().numpy(), chosen.level.cpu().numpy()
    nodes, levels = field.voxel.cpu().numpy(), field.level.cpu().numpy()
    voxel = chosen.voxel.cpu().numpy().copy()
    for number in np.unique(level):
        ends = [octree.node_of(end(nodes[levels == number], axis=0), number) for end in (np.min, np.max)]
        voxel[level == number] = octree.voxel_of(np.clip(position[level == number], *ends), number)
    arrays = {part.name: getattr(chosen, part.name) for part in fields(Field)}
    arrays = {name: value for name, value in arrays.items() if isinstance(value, Tensor)}
    return arrays | {"voxel": torch.from_numpy(voxel).to(chosen.voxel)}
