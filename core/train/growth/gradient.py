"""Statistics of gradients and opacities, and the places where anchors are added by them.

The rules are those of Octree-GS (docs/method.md, readings 3, 11 and 13).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64, Int32, Int64
from streamlod.core.render.raster import Probe
from streamlod.core.train.field.field import Field

_LEVEL_FACTOR = 2**0.2  # thresholds grow with the level
_EXTRA_SHARE = 0.25  # of the threshold, from which an anchor earns extra level
_REACH = (1 << 20) - 1  # nodes farther than this from the origin do not fit the packed keys
_TRUSTED_SHARE = 0.3  # of the largest visit count, below which a gradient average is not believed


class GrowthStatistics:
    """Sums over the steps since the last adjustment, for N anchors of K Gaussians."""

    def __init__(self, anchors: int, slots: int, device: torch.device) -> None:
        self._slots = slots
        self.gradient = torch.zeros(anchors * slots, device=device)
        self.gradient_count = torch.zeros(anchors * slots, device=device)
        self.opacity = torch.zeros(anchors, device=device)
        self.visits = torch.zeros(anchors, device=device)

    def add(self, probe: Probe, opacities: Tensor, rows: Tensor | None) -> None:
        """One step on a picture of the anchors `rows`, None for all, whose Gaussians have `opacities`."""
        self.add_gradients(probe, rows)
        opacity = opacities.detach().clamp_min(0).reshape(-1, self._slots).sum(dim=1)
        if rows is None:
            self.opacity += opacity
            self.visits += 1
        else:
            self.opacity.index_add_(0, rows, opacity)
            self.visits.index_add_(0, rows, torch.ones_like(opacity))

    def add_gradients(self, probe: Probe, rows: Tensor | None = None) -> None:
        """Gradients of one step alone, where nothing is pruned by opacity."""
        visible, norms, slots = probe.visible, probe.gradients.norm(dim=1), self._slots
        gaussians = visible if rows is None else rows[visible // slots] * slots + visible % slots
        self.gradient.index_add_(0, gaussians, norms)
        self.gradient_count.index_add_(0, gaussians, torch.ones_like(norms))

    def mean_gradient(self) -> Tensor:
        """[N*K] mean gradient norm where it was seen often enough, else 0."""
        enough = (_TRUSTED_SHARE * self.gradient_count.max()).clamp_min(1)
        return torch.where(self.gradient_count >= enough, self.gradient / self.gradient_count.clamp_min(1), 0.0)

    def faint(self, opacity: float) -> Tensor:
        """[N] anchors seen often enough whose opacity, summed over slots and averaged over visits, is below a limit."""
        often = self.visits >= (0.5 * self.visits.max()).clamp_min(1)
        return often & (self.opacity < opacity * self.visits)


@dataclass(frozen=True, slots=True, eq=False)
class NewAnchors:
    """n anchors to add: voxel [n,3] int32, level [n] int64, parent [n] int64 row of the anchor they grew from."""

    voxel: Int32
    level: Int64
    parent: Int64

    def __len__(self) -> int:
        return len(self.level)


def grow(
    field: Field, gradient: Tensor, first_threshold: float, highest: int, most: int, occupied: Field | None = None
) -> NewAnchors:
    """Where Gaussians pull hardest, an anchor at their own level; where harder still, one at the next finer level.

    Args:
        field: N anchors that were trained.
        gradient: [N*K] mean view-space gradient norms.
        first_threshold: norm from which level 0 grows; it rises with the level.
        highest: finest level that may receive anchors.
        most: anchors that may be added; where more would grow, those whose parents pull hardest do.
        occupied: all anchors there are, where `field` holds some of them only.
    """
    centres = field.gaussian_means.detach().reshape(-1, 3).cpu().numpy().astype(np.float64)
    slot_level = np.repeat(field.level.cpu().numpy(), field.slots)
    pull = gradient.cpu().numpy()
    found: list[NewAnchors] = []
    for level in range(field.octree.levels):
        threshold = first_threshold * _LEVEL_FACTOR**level
        hot = (slot_level == level) & (pull >= threshold)
        hotter = hot & (pull >= threshold * _LEVEL_FACTOR) & (level < highest)  # the finest level grows by itself only
        own, next_level = hot & ~hotter, hotter
        for target, candidates in ((level, own), (level + 1, next_level)):
            if target <= highest and candidates.any():
                found.append(_free_nodes(field, occupied or field, centres, np.flatnonzero(candidates), target))
    if not found:
        return NewAnchors(np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.zeros(0, np.int64))
    new = NewAnchors(
        *(np.concatenate([getattr(part, name) for part in found]) for name in ("voxel", "level", "parent"))
    )
    return _strongest(_unique(new), gradient.reshape(len(field), -1), most)


def earned_extra_level(field: Field, gradient: Tensor, first_threshold: float) -> Tensor:
    """[N] anchors whose mean gradient earns them extra level (paper section IV-A)."""
    per_slot = gradient.reshape(len(field), field.slots)
    mean = per_slot.sum(dim=1) / (per_slot > 0).sum(dim=1).clamp_min(1)
    threshold = first_threshold * _LEVEL_FACTOR ** field.level.float()
    return mean >= _EXTRA_SHARE * threshold


def _free_nodes(field: Field, occupied: Field, centres: Float64, candidates: Int64, level: int) -> NewAnchors:
    """The nodes of `level` nearest to the candidate Gaussians that hold no anchor yet, one each."""
    voxels = field.octree.voxel_of(centres[candidates], level)
    inside = np.abs(voxels).max(axis=1) < _REACH
    voxels, candidates = voxels[inside], candidates[inside]
    taken = occupied.voxel.cpu().numpy()[occupied.level.cpu().numpy() == level]
    unique, first = np.unique(voxels, axis=0, return_index=True)
    free = ~np.isin(_key(unique), _key(taken))
    parent = candidates[first[free]] // field.slots
    return NewAnchors(unique[free].astype(np.int32), np.full(len(parent), level, np.int64), parent)


def _unique(new: NewAnchors) -> NewAnchors:
    """One anchor a node: two parents of different levels may ask for the same."""
    _, first = np.unique(np.stack([new.level, _key(new.voxel)]), axis=1, return_index=True)
    first.sort()
    return NewAnchors(new.voxel[first], new.level[first], new.parent[first])


def _strongest(new: NewAnchors, pull: Tensor, limit: int) -> NewAnchors:
    """At most `limit` of `new`, those whose parents pull hardest; `pull` [N,K] are the gradient norms."""
    if len(new) <= limit:
        return new
    order = np.argsort(-pull.amax(dim=1).cpu().numpy()[new.parent], kind="stable")[:limit]
    order.sort()
    return NewAnchors(new.voxel[order], new.level[order], new.parent[order])


def _key(voxels: Int32) -> Int64:
    """[n] int64 that is different for different nodes within +-2^20."""
    shifted = voxels.astype(np.int64) + (1 << 20)
    return np.asarray((shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2])
