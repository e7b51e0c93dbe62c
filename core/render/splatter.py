"""Pictures of a changing scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamlod.core.arrays import Float32, Int64, UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.render.cpu import render
from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.expand import expand, expand_slots, visible, without_near
from streamlod.core.scene.exposures import NEUTRAL, CameraExposure, exposure_at
from streamlod.core.scene.gaussians import GaussianCloud, concatenate

_MAX_SIDE = 16384  # pixels of a picture


@dataclass(frozen=True, slots=True, eq=False)
class _Expanded:
    """A level, all its Gaussians, and those that are drawn."""

    level: AnchorLevel
    slots: GaussianCloud
    shown: GaussianCloud


def draw_cloud(cloud: GaussianCloud, camera: Camera, background: Float32, exposure: CameraExposure = NEUTRAL) -> UInt8:
    """[H,W,3] uint8 RGB of `cloud` before `background` [3], as `camera` sees it, at an exposure.

    Raises:
        InputError: a picture that is too large.
    """
    if max(camera.width, camera.height) > _MAX_SIDE:
        size = f"{camera.width}x{camera.height}"
        raise InputError(
            f"camera {camera.name}", f"its picture of {size} is too large; {_MAX_SIDE} a side are the most"
        )
    image = render(cloud, camera, background).image
    if not exposure.is_neutral:
        image = exposure.apply(image)
    return np.asarray(np.clip(np.round(image * 255), 0, 255), np.uint8)


def shown_at(scene: Scene, camera: Camera) -> CameraExposure:
    """The exposure at which `camera` is shown `scene`."""
    return exposure_at(camera.centre, scene.header.cameras, scene.metadata.exposures)


class Splatter:
    """Draws one scene after another.

    Where the network does not see the view, Gaussians of anchors that did not change since the last picture are kept.
    """

    def __init__(self) -> None:
        self._keyframe: Scene | None = None
        self._levels: dict[int, _Expanded] = {}

    def picture(self, scene: Scene, camera: Camera, levels: int | None = None) -> UInt8:
        """[H,W,3] uint8 RGB of `scene` as `camera` sees it.

        Args:
            levels: how many levels to draw, coarse ones first; all by default.

        Raises:
            InputError: a negative number of levels, or a picture that is too large.
        """
        return draw_cloud(self.cloud(scene, camera, levels), camera, scene.header.background, shown_at(scene, camera))

    def cloud(self, scene: Scene, camera: Camera, levels: int | None = None) -> GaussianCloud:
        """The Gaussians that `picture` draws: those of `core.scene.expand.expand`."""
        if levels is not None and levels < 0:
            raise InputError("levels", f"must be at least 0, not {levels}")
        count = len(scene.levels) if levels is None else min(levels, len(scene.levels))
        if scene.header.view_dependent:
            return expand(scene, camera.centre, count - 1)
        if self._keyframe is None or self._keyframe.weights is not scene.weights:
            self._levels = {}
        self._keyframe = scene
        for number in range(count):
            self._levels[number] = _update(scene, number, self._levels.get(number))
        cloud = concatenate([self._levels[number].shown for number in range(count)])
        return without_near(cloud, scene.header.cameras, camera.centre)


def _update(scene: Scene, number: int, before: _Expanded | None) -> _Expanded:
    """Level `number` expanded, the rows that did not change taken over from `before`."""
    level, slots = scene.levels[number], scene.header.gaussians_per_anchor
    if before is not None and before.level is level:
        return before
    rows = _changed_rows(None if before is None else before.level, level)
    fresh = expand_slots(scene.header, scene.weights, number, level, rows, np.zeros(3))
    parts = []
    for name in GaussianCloud.__slots__:
        new = getattr(fresh, name)
        whole = np.zeros((len(level), slots, *new.shape[1:]), np.float32)
        if before is not None:
            old = getattr(before.slots, name)
            kept = min(len(old) // slots, len(level))
            whole[:kept] = old.reshape(-1, slots, *new.shape[1:])[:kept]
        whole[rows] = new.reshape(len(rows), slots, *new.shape[1:])
        if name == "opacities":
            whole[~level.alive] = 0
        parts.append(whole.reshape(-1, *new.shape[1:]))
    cloud = GaussianCloud(*parts)
    return _Expanded(level, cloud, visible(cloud))


def _changed_rows(before: AnchorLevel | None, after: AnchorLevel) -> Int64:
    """Rows of `after` that are new or differ in what a residual can change."""
    if before is None or len(before) > len(after) or not np.array_equal(before.voxel, after.voxel[: len(before)]):
        return np.arange(len(after))
    count = len(before)
    changed = (before.position != after.position[:count]).any(axis=1)
    changed |= (before.latent != after.latent[:count]).any(axis=1)
    return np.concatenate([np.flatnonzero(changed), np.arange(count, len(after))])
