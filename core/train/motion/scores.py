"""Scores of change for anchors, from gradients and blending weights (paper section IV-B, equations 6 and 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from streamlod.core.arrays import Float64
from streamlod.core.render.backends import Backend
from streamlod.core.render.differentiable import rasterise
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.field import Field
from streamlod.core.train.pictures.boxes import tiles_near
from streamlod.core.train.pictures.views import Views


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """The evidence of a motion cue: the state of N anchors, and C cameras' pictures of the next instant.

    Attributes:
        field: the state before; canonical: the keyframe's field, with the same rows.
        alive: [N] bool.
        views: the pictures of the next instant.
        references: [C,H,W,3] pictures that the new ones are compared with, see `State`.
        masks: [C,H,W] bool, pixels that changed against the references, see `change_masks`.
        backend: of the rasteriser.
    """

    field: Field
    canonical: Field
    alive: Tensor
    views: Views
    references: Tensor
    masks: Tensor
    backend: Backend


def error_scores(seen: Observation) -> Float64:
    """[N] mean norm of the view-space gradient of the squared error between the keyframe as drawn and new pictures.

    The mean is over an anchor's visible Gaussians and the views that see it. Static error counts like motion.
    """
    return _mean_gradients(seen, seen.canonical, seen.views.usable, of_changes=False)


def change_scores(seen: Observation) -> Float64:
    """[N] as `error_scores`, of MSE(new picture) - MSE(reference picture) over the pixels that changed.

    The difference cancels the static error and is linear in the render (QUEEN).
    """
    changed = [number for number in seen.views.usable if seen.masks[number].any()]
    return _mean_gradients(seen, seen.field, changed, of_changes=True)


def _mean_gradients(seen: Observation, field: Field, numbers: list[int], *, of_changes: bool) -> Float64:
    """[N] view-space gradient norms of the living anchors of `field`, averaged over Gaussians and views `numbers`.

    Args:
        of_changes: in the error's derivative the reference picture stands in for the render; changed pixels alone.
    """
    rows = torch.nonzero(seen.alive)[:, 0]
    total, views_seen = np.zeros((2, len(field)))
    splats: Splats | None = None
    for number in numbers:
        camera, mask = seen.views.cameras[number], seen.masks[number]
        if splats is None or field.view_dependent:
            with torch.no_grad():
                splats = field.decode(seen.views.centres[number], rows)
        tiles = torch.from_numpy(tiles_near(mask.cpu().numpy(), 0)).to(rows.device) if of_changes else None
        raster = rasterise(
            splats.means.detach().requires_grad_(),
            *splats.astuple()[1:],
            camera=camera,
            background=torch.zeros(3, device=rows.device),
            gradient_rows=len(rows) * field.slots,
            tile_mask=tiles,
            backend=seen.backend,
        )
        shown = seen.references[number] if of_changes else raster.image.detach()
        gradient = 2 * (shown - seen.views.targets[number]) / shown.numel()
        raster.image.backward(gradient * mask[..., None] if of_changes else gradient)  # type: ignore[no-untyped-call]
        anchors = rows[raster.probe.visible // field.slots].cpu().numpy()
        norms = raster.probe.gradients.norm(dim=1).double().cpu().numpy()
        count = np.bincount(anchors, minlength=len(field))
        total += np.bincount(anchors, norms, minlength=len(field)) / np.maximum(count, 1)
        views_seen += count > 0
    return np.asarray(total / np.maximum(views_seen, 1))
