"""Turns a scene into plain Gaussians, with a fixed choice for what depends on the view.

Baked at one viewpoint, a view-dependent scene is exact there and an approximation elsewhere; averaged over several
viewpoints, it is an approximation everywhere, but nowhere far off.
"""

from __future__ import annotations

import numpy as np

from streamlod.core.arrays import Float32, Float64, Int64
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand_slots, visible
from streamlod.core.scene.gaussians import GaussianCloud, as_cloud, concatenate


def bake(scene: Scene, viewpoints: Float64) -> GaussianCloud:
    """The scene's Gaussians as seen from `viewpoints` [V,3], averaged over them where they differ.

    Opacities and scales are means over the views, colours are means weighted by opacity, rotations are means of unit
    quaternions on one hemisphere.

    Raises:
        ValueError: no viewpoint.
    """
    if len(viewpoints) == 0:
        raise ValueError("baking needs at least one viewpoint")
    levels = enumerate(scene.levels)
    return concatenate([baked_rows(scene, n, np.flatnonzero(level.alive), viewpoints) for n, level in levels])


def baked_rows(scene: Scene, number: int, rows: Int64, viewpoints: Float64) -> GaussianCloud:
    """The same for `rows` of level `number`, at one viewpoint or more."""
    points, level = viewpoints if scene.header.view_dependent else viewpoints[:1], scene.levels[number]
    views = [expand_slots(scene.header, scene.weights, number, level, rows, point) for point in points]
    return visible(_mean(views))


def _mean(views: list[GaussianCloud]) -> GaussianCloud:
    """One cloud from the same Gaussians seen from several viewpoints; means do not depend on the view."""
    if len(views) == 1:
        return views[0]
    opacities = np.stack([view.opacities for view in views])
    share = opacities / np.maximum(opacities.sum(axis=0), np.float32(1e-12))
    colours = sum(w[:, None] * view.colours for w, view in zip(share, views, strict=True))
    scales = np.mean([view.scales for view in views], axis=0)
    quaternions = _unit(views[0].quaternions)
    total = np.zeros_like(quaternions)
    for view in views:
        turned = _unit(view.quaternions)
        total += np.where((turned * quaternions).sum(axis=1, keepdims=True) < 0, -turned, turned)
    return as_cloud(views[0].means, total, scales, opacities.mean(axis=0), np.asarray(colours))


def _unit(quaternions: Float32) -> Float32:
    return np.asarray(
        quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), np.float32(1e-12)), np.float32
    )
