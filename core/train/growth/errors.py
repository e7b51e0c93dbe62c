"""Where a later frame lacks anchors: the nodes of the octree on which most of the pictures' error lies.

A turning thing shows sides on which no anchor has ever stood, and what comes in has none at all. Anchors nearby are
then drawn over to it, and it fades. The error of the pictures says where that happens, and the depths at which the
worst pixels match other views say where in space; a node counts where most of the views that see it err.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from streamlod.core.arrays import Float32, Float64, Int32, Int64
from streamlod.core.initialise.views import inside, project
from streamlod.core.train.field.field import Field
from streamlod.core.train.growth.depth_search import matched_pixels
from streamlod.core.train.growth.gradient import NewAnchors
from streamlod.core.train.growth.new_anchors import first_values
from streamlod.core.train.pictures.views import Views

_WINDOW = 3  # pixels whose error a new anchor may mend
_LATTICE = 2  # every second pixel of every second row is asked
_PIXELS_A_NODE = 2  # pixels that are looked for in space, for each anchor that may be added
_AGREEING_SHARE = 0.7  # share of the views that see a node, whose error must lie there
_AGREEING_ERROR = 0.25  # of the mean error of these views, from which a view agrees
ANCHOR_BITS = (
    120.0  # price of an anchor; its numbers really take about 200 (docs/history/log.md, what a latent changes)
)
_MENDED = 0.4  # share of its error that an anchor mends
_OPAQUE, _ALIKE = 0.3, 0.1  # of anchors whose features new ones take: least opacity, largest difference of colours


@dataclass(frozen=True, slots=True, eq=False)
class ErrorNodes:
    """n nodes: voxel [n,3] of level [n], mean position [n,3] in the world and colour [n,3] of the pixels seen there."""

    voxel: Int32
    level: Int64
    position: Float64
    colour: Float64

    def __len__(self) -> int:
        return len(self.level)


def error_nodes(
    living: Field, views: Views, drawn: Mapping[int, Tensor], masks: Tensor, most: int, anchor_price: float
) -> ErrorNodes:
    """At most `most` nodes on which the error of pictures lies, the worst first.

    Args:
        living: anchors that say how deep the scene is, and whose octree has the nodes.
        views: the pictures as they should be. drawn: [H,W,3] as they are, by the number of the view.
        masks: [C,H,W] bool, pixels whose error counts.
        anchor_price: in units of one picture's sum of absolute errors; nodes whose error is not worth it are left out.
    """
    nowhere = ErrorNodes(np.zeros((0, 3), np.int32), np.zeros(0, np.int64), *np.zeros((2, 0, 3)))
    if most <= 0:
        return nowhere
    errors = {number: _error(picture, views.targets[number], masks[number]) for number, picture in drawn.items()}
    worst = _worst_pixels(errors, _PIXELS_A_NODE * most)
    found = [matched_pixels(living, views, number, *pixels) for number, pixels in worst.items() if len(pixels[0])]
    if not found:
        return nowhere
    position, width = (np.concatenate([getattr(part, name) for part in found]) for name in ("position", "width"))
    colour = np.concatenate([views.targets[part.view].cpu().numpy()[part.row, part.column] for part in found])
    nodes, at = np.unique(_nodes(living, position, _LATTICE * width), axis=0, return_inverse=True)
    position, colour = (_means(values, at.ravel(), len(nodes)) for values in (position, colour))
    error, agreeing = _witnesses(errors, views, position)
    price = anchor_price / _MENDED
    best = np.argsort(-error, kind="stable")
    best = best[((_LATTICE / _WINDOW) ** 2 * error[best] > price) & (agreeing[best] >= _AGREEING_SHARE)][:most]
    return ErrorNodes(nodes[best, 1:].astype(np.int32), nodes[best, 0], position[best], colour[best])


def values_at(living: Field, nodes: ErrorNodes, generator: torch.Generator) -> dict[str, Tensor]:
    """The seven arrays of anchors at `nodes`: as wide as their cells, with the features of anchors of their colours."""
    device = living.feature.device
    with torch.no_grad():
        splats = living.decode(torch.zeros(3, device=device))
    opacity = splats.opacities.reshape(len(living), -1).amin(dim=1)
    colours = splats.colours.reshape(len(living), -1, 3)
    plain = (opacity > _OPAQUE) & ((colours.amax(dim=1) - colours.amin(dim=1)).amax(dim=1) < _ALIKE)
    models = torch.nonzero(plain)[:, 0] if bool(plain.any()) else torch.arange(len(living), device=device)
    _, nearest = cKDTree(colours[models].mean(dim=1).cpu().numpy()).query(nodes.colour)
    parents = models[torch.from_numpy(nearest).to(device)].cpu().numpy()
    values = first_values(living, NewAnchors(nodes.voxel, nodes.level, parents), generator)
    return values | {"position": torch.from_numpy(nodes.position).float().to(device)}


def _error(drawn: Tensor, target: Tensor, mask: Tensor) -> Float32:
    """[H,W] sum of the absolute errors of the channels over the window round each pixel."""
    error = ((drawn - target).abs().sum(dim=2) * mask).cpu().numpy()
    return np.asarray(cv2.boxFilter(error, -1, (_WINDOW, _WINDOW), normalize=False))


def _worst_pixels(errors: Mapping[int, Float32], most: int) -> dict[int, tuple[Int64, Int64]]:
    """Rows and columns by the number of the view: the `most` pixels of the lattice with the largest errors of all."""
    lattices = {number: error[::_LATTICE, ::_LATTICE] for number, error in errors.items()}
    values = np.concatenate([lattice.ravel() for lattice in lattices.values()])
    least = np.partition(values, -most)[-most] if most < len(values) else 0.0
    return {
        number: (rows * _LATTICE, columns * _LATTICE)
        for number, lattice in lattices.items()
        for rows, columns in [np.nonzero((lattice >= least) & (lattice > 0))]
    }


def _nodes(field: Field, position: Float64, width: Float64) -> Int64:
    """[n,4] level and voxel of the node nearest to each position, on the level whose cells are about `width` [n]."""
    wanted = np.round(np.log2(field.octree.root_cell / width))
    level = np.clip(wanted, 0, field.octree.levels - 1).astype(np.int64)
    return np.concatenate([level[:, None], field.octree.voxel_of(position, level)], axis=1)


def _means(values: Float64, group: Int64, groups: int) -> Float64:
    """[groups,3] mean of the rows of `values` [n,3] of each `group` [n]."""
    sums = [np.bincount(group, values[:, axis], groups) for axis in range(3)]
    return np.stack(sums, axis=1) / np.bincount(group, minlength=groups)[:, None]


def _witnesses(errors: Mapping[int, Float32], views: Views, position: Float64) -> tuple[Float64, Float64]:
    """([n] mean error at `position` [n,3] in the pictures that show it, [n] share of these that agree).

    A view agrees where its own error is at least a quarter of the mean. A place in free space has others behind it,
    which most views show as they should.
    """
    seen, there = np.zeros((2, len(errors), len(position)))
    for i, (number, error) in enumerate(errors.items()):
        pixels, depth = project(views.cameras[number], position)
        within = inside(views.cameras[number], pixels, depth)
        column, row = pixels[within].astype(np.int64).T
        seen[i, within], there[i, within] = 1.0, error[row, column]
    count = np.maximum(seen.sum(axis=0), 1.0)
    mean = there.sum(axis=0) / count
    agreeing = np.where(seen.sum(axis=0) > 1, (seen * (there >= _AGREEING_ERROR * mean)).sum(axis=0) / count, 0.0)
    return mean, agreeing
