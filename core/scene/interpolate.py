"""The Gaussians between two states of one keyframe, for more pictures a second than there are states.

Rows keep their number from state to state, so each Gaussian of one state is found again in the other, and both are
mixed linearly: place, scale, rotation, opacity and colour. The page does so with places and opacities alone, in its
vertex shader (client/web/view/renderer.js).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from streamlod.core.arrays import Float32, Float64
from streamlod.core.scene.anchors import AnchorLevel, Scene, append_rows
from streamlod.core.scene.expand import expand_slots, visible, without_near
from streamlod.core.scene.gaussians import GaussianCloud, concatenate


def can_interpolate(before: Scene, after: Scene) -> bool:
    """Whether `after` follows on `before`; each keyframe numbers its rows anew."""
    is_same = (before.keyframe, before.identifier) == (after.keyframe, after.identifier)
    return is_same and before.version <= after.version


def interpolate(
    before: Scene, after: Scene, share: float, viewpoint: Float64, highest_level: int | None = None
) -> GaussianCloud:
    """The Gaussians seen from `viewpoint` after `share` of the time from `before` to `after`.

    A Gaussian that only one of the states has stays where that one has it and fades in or out.

    Args:
        share: 0 gives `before`, 1 gives `after`, as `core.scene.expand.expand` does.
        viewpoint: [3] camera centre in world units.
        highest_level: finest level to draw; all levels by default.

    Raises:
        ValueError: `after` does not follow on `before` (`can_interpolate`).
    """
    if not can_interpolate(before, after):
        raise ValueError(
            f"version {after.version} of keyframe {after.keyframe} does not follow on "
            f"version {before.version} of keyframe {before.keyframe}"
        )
    top = len(after.levels) - 1 if highest_level is None else min(highest_level, len(after.levels) - 1)
    clouds = []
    for number in range(top + 1):
        early, late = before.levels[number], after.levels[number]
        begin = _slots(after, number, _with_rows_of(early, late), viewpoint)
        end = _slots(after, number, late, viewpoint)
        clouds.append(visible(_mixed(begin, end, share)))
    return without_near(concatenate(clouds), after.header.cameras, viewpoint)


def _with_rows_of(early: AnchorLevel, late: AnchorLevel) -> AnchorLevel:
    """`early`, then the rows that only `late` has, which are not alive yet."""
    added = AnchorLevel(*(getattr(late, name)[len(early) :] for name in AnchorLevel.__slots__))
    return append_rows(early, replace(added, alive=np.zeros(len(added), np.bool_)))


def _slots(scene: Scene, number: int, level: AnchorLevel, viewpoint: Float64) -> GaussianCloud:
    """All slots of all rows, of opacity 0 where an anchor is not alive."""
    cloud = expand_slots(scene.header, scene.weights, number, level, np.arange(len(level)), viewpoint)
    alive = np.repeat(level.alive, scene.header.gaussians_per_anchor)
    return replace(cloud, opacities=np.where(alive, cloud.opacities, np.float32(0)))


def _mixed(first: GaussianCloud, second: GaussianCloud, share: float) -> GaussianCloud:
    """Slot by slot."""
    is_new, is_gone = first.opacities == 0, second.opacities == 0

    def mix(early: Float32, late: Float32) -> Float32:
        begin = np.where(is_new[:, None], late, early)
        end = np.where(is_gone[:, None], early, late)
        return np.asarray(begin * np.float32(1 - share) + end * np.float32(share), np.float32)

    return GaussianCloud(
        means=mix(first.means, second.means),
        quaternions=mix(*_aligned(first.quaternions, second.quaternions)),
        scales=mix(first.scales, second.scales),
        opacities=first.opacities * np.float32(1 - share) + second.opacities * np.float32(share),
        colours=mix(first.colours, second.colours),
    )


def _aligned(first: Float32, second: Float32) -> tuple[Float32, Float32]:
    """Quaternions [n,4] of unit length; of the two that say the second rotation, the nearer one to the first."""
    first, second = _unit(first), _unit(second)
    is_opposite = (first * second).sum(axis=1, keepdims=True) < 0
    return first, np.where(is_opposite, -second, second)


def _unit(quaternions: Float32) -> Float32:
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.asarray(quaternions / np.maximum(length, np.float32(1e-12)), np.float32)
