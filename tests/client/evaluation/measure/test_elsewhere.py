"""Cameras of a recording beside those of a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from streamlod.client.evaluation.measure.elsewhere import told_elsewhere
from streamlod.core.camera import Camera
from streamlod.core.camera.space import Similarity
from tests.client.clips import plain_scene

KNOWN = plain_scene().header.cameras


def _turned(camera: Camera, degrees: float) -> Camera:
    """The camera, looking so far to the side."""
    angle = np.radians(degrees)
    pose = camera.world_to_camera.copy()
    pose[:3] = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]) @ pose[:3]
    return replace(camera, world_to_camera=pose)


@pytest.mark.parametrize(("degrees", "told"), [(0, None), (1, None), (10, "by 10 degrees")])
def test_a_camera_that_looks_elsewhere_is_named(degrees: float, told: str | None) -> None:
    sentence = told_elsewhere([*KNOWN[:-1], _turned(KNOWN[-1], degrees)], KNOWN)
    if told is None:
        assert sentence is None
    else:
        assert sentence is not None
        assert f"({KNOWN[-1].name} {told}" in sentence


def test_what_is_far_counts_in_the_size_of_the_rig() -> None:
    first = KNOWN[0]
    pose = first.world_to_camera.copy()
    pose[0, 3] += 1
    moved = replace(first, world_to_camera=pose)
    one = told_elsewhere([moved], KNOWN)
    assert one is not None
    millimetres = Similarity(1000.0, np.eye(3), np.zeros(3)).camera
    assert told_elsewhere([millimetres(moved)], [*map(millimetres, KNOWN)]) == one


def test_cameras_of_other_names_say_nothing() -> None:
    assert told_elsewhere([replace(_turned(KNOWN[0], 90), name="other")], KNOWN) is None
