"""Growing and pruning between the training steps of the first frame (paper section IV-A)."""

from __future__ import annotations

import torch
from torch import Tensor

from core.render.raster import Raster
from core.train.config import KeyframeConfig
from core.train.field.decode import Splats
from core.train.field.field import Field
from core.train.field.learned import LearnedField
from core.train.growth.new_anchors import strongest
from core.train.growth.rule import GrowthStatistics, NewAnchors, earned_extra_level, grow

_OFFSET_SPREAD = 0.3


def count(statistics: GrowthStatistics, raster: Raster, splats: Splats, rows: Tensor | None, slots: int) -> None:
    """Add what one picture shows of the anchors `rows` (all by default) of `slots` Gaussians each."""
    visible = raster.probe.visible
    norms = raster.probe.gradients.norm(dim=1)
    opacity = splats.opacities.detach().clamp_min(0).reshape(-1, slots).sum(dim=1)
    anchors = torch.arange(len(opacity), device=visible.device) if rows is None else rows
    statistics.add(anchors[visible // slots] * slots + visible % slots, norms, anchors, opacity)


def refine(
    learned: LearnedField,
    statistics: GrowthStatistics,
    config: KeyframeConfig,
    highest: int,
    most_anchors: int,
    generator: torch.Generator,
) -> None:
    """Grow and prune `learned`.

    Args:
        statistics: of the steps since the last time.
        highest: finest level that may receive anchors.
        most_anchors: that there may be.
    """
    field, gradient = learned.settled, statistics.mean_gradient()
    extra = earned_extra_level(field, gradient, config).float() * config.extra_level_gain
    new = grow(field, gradient, config.growth_threshold, highest)
    new = strongest(new, gradient.reshape(len(field), -1), max(most_anchors - len(field), 0))
    kept = torch.nonzero(~statistics.faint(config.prune_opacity))[:, 0]
    if len(kept) + len(new) == 0:  # nothing would ever grow again
        return
    learned.keep(kept, _children(field, new, generator), extra)


def _children(field: Field, new: NewAnchors, generator: torch.Generator) -> dict[str, Tensor]:
    """The seven arrays of `new` anchors, with their parents' features, on their nodes."""
    device = field.feature.device
    level, voxel = torch.from_numpy(new.level).to(device), torch.from_numpy(new.voxel).to(device)
    cells = field.octree.root_cell / 2.0 ** level.double()
    return {
        "level": level,
        "voxel": voxel,
        "extra_level": torch.zeros(len(new), device=device),
        "position": (torch.from_numpy(field.octree.origin).to(device) + voxel * cells[:, None]).float(),
        "feature": field.feature[torch.from_numpy(new.parent).to(device)],
        "offset": _OFFSET_SPREAD * torch.randn(len(new), field.slots, 3, generator=generator, device=device),
        "scaling": cells.log().float()[:, None].repeat(1, 6),
    }
