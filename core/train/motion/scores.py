"""Scores of change for anchors, from gradients and blending weights (paper section IV-B, equations 6 and 7)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from streamlod.core.arrays import Float64
from streamlod.core.render.backends import Backend
from streamlod.core.render.differentiable import rasterise
from streamlod.core.render.tiles import TILE_HEIGHT, TILE_WIDTH, tile_grid
from streamlod.core.train.field.decode import Splats
from streamlod.core.train.field.field import Field
from streamlod.core.train.motion.partition import Observation
from streamlod.core.train.pictures.views import Views


def error_scores(field: Field, seen: Observation) -> Float64:
    """[N] mean norm of the view-space gradient of the squared error between `field` as drawn and the new pictures.

    The mean is over an anchor's visible Gaussians and the views that see it. Static error counts like motion.
    """
    rows = torch.nonzero(seen.alive)[:, 0]
    mean = _GradientMean(field, rows)
    for number in seen.views.usable:
        mean.add(number, seen.views, None, None, seen.backend)
    return mean.value()


def change_scores(seen: Observation) -> Float64:
    """[N] as `error_scores`, of MSE(new picture) - MSE(reference picture) over the pixels that changed.

    The difference cancels the static error and is linear in the render (QUEEN).
    """
    mean = _GradientMean(seen.field, torch.nonzero(seen.alive)[:, 0])
    for number in seen.views.usable:
        if seen.masks[number].any():
            mean.add(number, seen.views, seen.references[number], seen.masks[number], seen.backend)
    return mean.value()


def tiles_of(mask: Tensor) -> Tensor:
    """[tiles_y,tiles_x] bool: tiles that hold a pixel of `mask` [H,W]."""
    height, width = mask.shape
    rows, columns = tile_grid(width, height)
    padding = (0, columns * TILE_WIDTH - width, 0, rows * TILE_HEIGHT - height)
    padded = functional.pad(mask.float(), padding)[None, None]
    tiles = functional.max_pool2d(padded, (TILE_HEIGHT, TILE_WIDTH))
    return tiles[0, 0] > 0


class _GradientMean:
    """View-space gradient norms of the anchors, averaged over Gaussians and views."""

    def __init__(self, field: Field, rows: Tensor) -> None:
        self._field, self._rows = field, rows
        self._total, self._views_seen = np.zeros(len(field)), np.zeros(len(field))
        self._splats: Splats | None = None

    def add(self, number: int, views: Views, base: Tensor | None, mask: Tensor | None, backend: Backend) -> None:
        """One view. `base` [H,W,3] stands in for the render in the error's derivative; `mask` [H,W] limits it."""
        field, rows, camera = self._field, self._rows, views.cameras[number]
        if self._splats is None or field.view_dependent:
            with torch.no_grad():
                self._splats = field.decode(torch.from_numpy(camera.centre).float().to(rows.device), rows)
        splats = self._splats
        raster = rasterise(
            splats.means.detach().requires_grad_(),
            *splats.astuple()[1:],
            camera=camera,
            background=torch.zeros(3, device=rows.device),
            gradient_rows=len(rows) * field.slots,
            tile_mask=None if mask is None else tiles_of(mask),
            backend=backend,
        )
        shown = raster.image.detach() if base is None else base
        gradient = 2 * (shown - views.targets[number]) / shown.numel()
        raster.image.backward(gradient if mask is None else gradient * mask[..., None])  # type: ignore[no-untyped-call]
        anchors = rows[raster.probe.visible // field.slots].cpu().numpy()
        norms = raster.probe.gradients.norm(dim=1).double().cpu().numpy()
        count = np.bincount(anchors, minlength=len(field))
        self._total += np.bincount(anchors, norms, minlength=len(field)) / np.maximum(count, 1)
        self._views_seen += count > 0

    def value(self) -> Float64:
        """[N] mean over the views that see an anchor."""
        return np.asarray(self._total / np.maximum(self._views_seen, 1))
