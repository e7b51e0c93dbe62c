"""Scores of motion for the anchors of a scene, and what follows from them (paper section IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from core.arrays import Bool, Float64, Int64
from core.render.backends import Backend
from core.render.differentiable import rasterise
from core.render.tiles import TILE_HEIGHT, TILE_WIDTH, tile_grid
from core.train.config import PredictConfig
from core.train.field.decode import Splats
from core.train.field.field import Field
from core.train.motion.coverage import coverage
from core.train.motion.masks import changed_pixels, dynamic_anchors, moved_pixels
from core.train.pictures.views import Views

_HYSTERESIS = 0.5  # an anchor stays dynamic above this share of the entering posterior
_SHARE_POWER = 2  # of an anchor's share of moved pixels, in its score of motion
_SHOWS = 0.1  # share of moved pixels from which an anchor that training keeps moving is taken to move
_MOST = 0.5  # of the pixels, above which nothing is left that stands still and the mixture would split what moves


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What a frame's training does with N anchors.

    Attributes:
        dynamic: [N] bool, they are taken to move; None where nobody asked.
        trained: [N] bool, those, and the others that show a change: shadows, reflections, what was uncovered.
    """

    dynamic: Bool | None
    trained: Bool

    def among(self, alive: Bool) -> Parts:
        """Only those of `alive` [N]."""
        return Parts(None if self.dynamic is None else self.dynamic & alive, self.trained & alive)

    def relaid(self, origin: Int64) -> Parts:
        """For rows in another order: `origin` [M] says where each was, -1 for new ones, which count as dynamic."""
        rows, new = np.maximum(origin, 0), origin < 0
        dynamic = None if self.dynamic is None else new | self.dynamic[rows]
        return Parts(dynamic, new | self.trained[rows])


def no_parts(anchors: int) -> Parts:
    """Nothing is trained."""
    return Parts(np.zeros(anchors, np.bool_), np.zeros(anchors, np.bool_))


def change_masks(references: Tensor, views: Views, floor: float) -> Tensor:
    """[C,H,W] bool: pixels of each usable camera that changed against `references` [C,H,W,3]."""
    masks = torch.zeros(references.shape[:3], dtype=torch.bool, device=references.device)
    for number in views.usable:
        changed = changed_pixels(references[number].cpu().numpy(), views.targets[number].cpu().numpy(), floor)
        masks[number] = torch.from_numpy(changed).to(references.device)
    return masks


def partition(
    field: Field,
    alive: Tensor,
    references: Tensor,
    views: Views,
    masks: Tensor,
    previous: Parts,
    drifting: Bool,
    config: PredictConfig,
    backend: Backend,
    *,
    label: bool = True,
) -> Parts:
    """Which anchors to train for this frame, and how.

    Args:
        field: the state before; for the `canonical` cue, that of the keyframe.
        alive: [N] bool.
        references: [C,H,W,3] pictures that the state was trained to show.
        masks: [C,H,W] bool from `change_masks`.
        previous: of the frame before.
        drifting: [N] bool, anchors that training keeps moving.
        label: also tell which of them move, where that takes drawing the scene twice more.
    """
    if config.everything:
        everything = np.asarray(alive.cpu().numpy())
        return Parts(everything, everything)
    if not masks.any():  # whatever the cue: static error is no motion
        return no_parts(len(field))
    rows = torch.nonzero(alive)[:, 0]
    if config.cue != "difference":  # all that is trained moves
        scores = error_scores(field, rows, views, backend)
        dynamic = dynamic_anchors(scores, previous.trained, config.posterior, config.posterior * _HYSTERESIS)
        return Parts(dynamic, dynamic)
    lowest = config.changed_posterior
    scores = change_scores(field, rows, rows[:0], references, views, masks, backend)
    changed = dynamic_anchors(scores, previous.trained, lowest, lowest * _HYSTERESIS)
    if masks[views.usable].float().mean() > _MOST:
        changed = scores > 0
    if not changed.any():
        return no_parts(len(field))
    if not label:
        return Parts(None, changed)
    known = np.zeros(len(field), np.bool_) if previous.dynamic is None else previous.dynamic
    return Parts(_moving(field, alive, references, views, masks, changed, known, drifting, config, backend), changed)


def _moving(
    field: Field,
    alive: Tensor,
    references: Tensor,
    views: Views,
    masks: Tensor,
    changed: Bool,
    previous: Bool,
    drifting: Bool,
    config: PredictConfig,
    backend: Backend,
) -> Bool:
    """[N] which of the anchors `changed` [N] move: they explain what no change of light does, and show little else, or
    show some of it and are `drifting` [N]."""
    moved = torch.zeros_like(masks)
    for number in views.usable:
        if masks[number].any():
            pictures = references[number].cpu().numpy(), views.targets[number].cpu().numpy()
            moved[number] = torch.from_numpy(moved_pixels(*pictures, config.noise_floor)).to(masks.device)
    moved &= masks
    chosen = torch.from_numpy(changed).to(alive.device)
    rows, others = torch.nonzero(chosen)[:, 0], torch.nonzero(alive & ~chosen)[:, 0]
    scores = change_scores(field, rows, others, references, views, moved, backend)
    shares = shown_shares(field, rows, others, views, moved, backend)
    scores = scores * shares**_SHARE_POWER
    return dynamic_anchors(scores, previous, config.posterior, config.posterior * _HYSTERESIS) | (
        changed & drifting & (shares >= _SHOWS)
    )


def error_scores(field: Field, rows: Tensor, views: Views, backend: Backend) -> Float64:
    """[N] mean norm of the view-space gradient of MSE(I_t), over an anchor's visible Gaussians and the views that see
    it, 0 but for `rows`: the cue of the paper, on the keyframe's state (`canonical`) or the latest (`previous`)."""
    average = _Average(field, rows, rows[:0])
    for number in views.usable:
        average.add(number, views, None, None, backend)
    return average.mean()


def change_scores(
    field: Field, rows: Tensor, others: Tensor, references: Tensor, views: Views, masks: Tensor, backend: Backend
) -> Float64:
    """As `error_scores`, of MSE(I_t) - MSE(I_ref) over the pixels of `masks` [C,H,W]; `others` are only drawn.

    The difference cancels the static error and is linear in the render (QUEEN).
    """
    average = _Average(field, rows, others)
    for number in views.usable:
        if masks[number].any():
            average.add(number, views, references[number], masks[number], backend)
    return average.mean()


def shown_shares(field: Field, rows: Tensor, others: Tensor, views: Views, masks: Tensor, backend: Backend) -> Float64:
    """[N] share of what an anchor shows that lies on `masks` [C,H,W], over the views in which any pixel does.

    0 but for `rows`; `others` are only drawn.
    """
    inside, total = torch.zeros(len(rows), device=rows.device), torch.zeros(len(rows), device=rows.device)
    for number in views.usable:
        mask = masks[number]
        if not mask.any():
            continue
        maps = torch.stack([torch.ones_like(mask), mask], dim=2).float()
        sums = coverage(field, rows, others, views.cameras[number], maps, backend, tiles_of(mask, room=1))
        total += sums[:, 0]
        inside += sums[:, 1]
    shares = np.zeros(len(field))
    shares[rows.cpu().numpy()] = (inside / total.clamp_min(1e-6)).double().cpu().numpy()
    return shares


def tiles_of(mask: Tensor, room: int = 0) -> Tensor:
    """[tiles_y,tiles_x] bool: tiles that hold a pixel of `mask` [H,W], and `room` more on every side."""
    height, width = mask.shape
    rows, columns = tile_grid(width, height)
    padding = (0, columns * TILE_WIDTH - width, 0, rows * TILE_HEIGHT - height)
    padded = functional.pad(mask.float(), padding)[None, None]
    tiles = functional.max_pool2d(padded, (TILE_HEIGHT, TILE_WIDTH))
    if room:
        tiles = functional.max_pool2d(tiles, 2 * room + 1, stride=1, padding=room)
    return tiles[0, 0] > 0


class _Average:
    """View-space gradient norms of the anchors, averaged over Gaussians and views."""

    def __init__(self, field: Field, rows: Tensor, others: Tensor) -> None:
        self._field, self._rows, self._wanted = field, torch.cat([rows, others]), len(rows)
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
            gradient_rows=self._wanted * field.slots,
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

    def mean(self) -> Float64:
        """[N] mean over the views that see an anchor."""
        return np.asarray(self._total / np.maximum(self._views_seen, 1))
