"""Cameras of a recording that stand elsewhere than those of the same names in a file: most likely another recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamlod.core.camera import Camera
from streamlod.core.camera.space import VIEWING_DISTANCE, training_space

_ANOTHER_RIG = 5.0  # degrees; two calibrations of one rig differ by less than one


def told_elsewhere(placed: Sequence[Camera], known: Sequence[Camera]) -> str | None:
    """A sentence about the camera that is farthest from the one of its name in `known`; None where all are near.

    Args:
        placed: cameras in the space of `known`. known: cameras of a file.
    """
    by_name = {camera.name: camera for camera in known}
    pairs = [(camera, by_name[camera.name]) for camera in placed if camera.name in by_name]
    if not pairs:
        return None
    distance = VIEWING_DISTANCE / training_space(known).scale
    found = {ours.name: _degrees(ours, theirs, distance) for ours, theirs in pairs}
    worst = max(found, key=found.__getitem__)
    if found[worst] < _ANOTHER_RIG:
        return None
    apart = f"{worst} by {found[worst]:.0f} degrees as seen from the middle of the scene"
    return f"its cameras stand elsewhere than those of the file ({apart}); is it the recording that trained the file?"


def _degrees(one: Camera, other: Camera, distance: float) -> float:
    """Angle by which a camera was turned, and that between its places as seen from so far."""
    turn = one.world_to_camera[:3, :3] @ other.world_to_camera[:3, :3].T
    turned = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    return float(np.degrees(turned + np.linalg.norm(one.centre - other.centre) / distance))
