"""Scores of motion for the anchors of a scene, one render and one backward pass a camera (paper section III-B)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from core.arrays import Bool, Float64
from core.render.backends import Backend
from core.render.differentiable import rasterise
from core.train.config import PredictConfig
from core.train.field import Field
from core.train.keyframe import Views
from core.train.motion import changed_pixels, dynamic_anchors

_HYSTERESIS = 0.5  # an anchor stays dynamic above this share of the entering posterior


def change_masks(references: Tensor, views: Views, floor: float) -> Tensor:
    """[C,H,W] bool: pixels of each usable camera that changed against `references` [C,H,W,3]."""
    masks = torch.zeros(references.shape[:3], dtype=torch.bool, device=references.device)
    for number in views.usable:
        changed = changed_pixels(references[number].cpu().numpy(), views.targets[number].cpu().numpy(), floor)
        masks[number] = torch.from_numpy(changed).to(references.device)
    return masks


def renewed_references(references: Tensor, shown: Tensor, views: Views, masks: Tensor, floor: float) -> Tensor:
    """[C,H,W,3] what the next frame's pictures are compared with.

    Where a change was accepted, the picture just trained on; but where the model still shows something else by more
    than `floor`, what it shows: so the difference counts as a change again, and is trained until it has gone. Without
    this, what a moving thing uncovers would stay wrong for ever: it is learnt badly at first and then stands still.
    """
    renewed = torch.where(masks[..., None], views.targets, references)  # a copy: the references stay as they are
    for number in views.usable:
        if masks[number].any():
            wrong = changed_pixels(shown[number].cpu().numpy(), views.targets[number].cpu().numpy(), floor)
            unsettled = masks[number] & torch.from_numpy(wrong).to(masks.device)
            renewed[number] = torch.where(unsettled[..., None], shown[number], renewed[number])
    return renewed


def rendered(field: Field, alive: Tensor, views: Views, backend: Backend) -> Tensor:
    """[C,H,W,3] what `field` shows the usable cameras now; black for the others."""
    pictures = torch.zeros_like(views.targets)
    rows = torch.nonzero(alive)[:, 0]
    background = torch.zeros(3, device=rows.device)
    with torch.no_grad():
        for number in views.usable:
            camera = views.cameras[number]
            splats = field.decode(torch.from_numpy(camera.centre).float().to(rows.device), rows)
            raster = rasterise(*splats.astuple(), camera=camera, background=background, backend=backend)
            pictures[number] = raster.image.clamp(0, 1)
    return pictures


def partition(
    field: Field,
    alive: Tensor,
    references: Tensor,
    views: Views,
    masks: Tensor,
    previous: Bool,
    config: PredictConfig,
    backend: Backend,
) -> Bool:
    """[N] anchors to train for this frame.

    Args:
        field: the state before; for the `canonical` cue, that of the keyframe.
        alive: [N] bool.
        references: [C,H,W,3] pictures that the state was trained to show.
        masks: [C,H,W] bool from `change_masks`.
        previous: [N] dynamic in the frame before.
    """
    if config.everything:
        return np.asarray(alive.cpu().numpy())
    scores = motion_scores(field, alive, references, views, masks, config, backend)
    return dynamic_anchors(scores, previous, config.posterior, config.posterior * _HYSTERESIS)


def motion_scores(
    field: Field,
    alive: Tensor,
    references: Tensor,
    views: Views,
    masks: Tensor,
    config: PredictConfig,
    backend: Backend,
) -> Float64:
    """[N] mean norm of the view-space gradient over an anchor's visible Gaussians and over the views that see it.

    `difference` takes the gradient of MSE(I_t) - MSE(I_ref), which cancels the static error and is linear in the
    render (QUEEN); `previous` and `canonical` take that of MSE(I_t), the latter on the keyframe's state (the paper).
    """
    total, views_seen = np.zeros(len(field)), np.zeros(len(field))
    masked = config.cue == "difference"
    for number in views.usable:
        mask = masks[number]
        if masked and not mask.any():
            continue
        camera = views.cameras[number]
        rows = torch.nonzero(alive)[:, 0]
        with torch.no_grad():
            splats = field.decode(torch.from_numpy(camera.centre).float().to(rows.device), rows)
        means = splats.means.requires_grad_()
        raster = rasterise(
            means,
            splats.quaternions,
            splats.scales,
            splats.opacities,
            splats.colours,
            camera,
            torch.zeros(3, device=rows.device),
            backend=backend,
        )
        base = references[number] if masked else raster.image.detach()
        gradient = 2 * (base - views.targets[number]) / base.numel()
        raster.image.backward(gradient * mask[..., None] if masked else gradient)  # type: ignore[no-untyped-call]
        visible = raster.probe.visible
        anchors = rows[visible // field.slots].cpu().numpy()
        norms = raster.probe.gradients.norm(dim=1).double().cpu().numpy()
        count = np.bincount(anchors, minlength=len(field))
        total += np.bincount(anchors, norms, minlength=len(field)) / np.maximum(count, 1)
        views_seen += count > 0
    return total / np.maximum(views_seen, 1)
