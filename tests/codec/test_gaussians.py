"""FORMAT.md section 14: what this project's renderers are given is what the document says, within its tolerances."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from streamlod.core.scene.anchors import AnchorLevel, Scene
from streamlod.core.scene.expand import anchor_positions, expand_slots
from streamlod.core.scene.octree import level_for_distance
from tests.vectors.gaussians import PATH, decoded

VECTORS: dict[str, Any] = json.loads(PATH.read_text())


def _rows(scene: Scene, number: int, level: AnchorLevel, eye: np.ndarray, by_distance: bool) -> np.ndarray:
    rows = np.flatnonzero(level.alive[: VECTORS["rows"]])
    if not by_distance:
        return rows
    positions = anchor_positions(scene.header, number, level)[rows].astype(np.float64)
    distance = np.linalg.norm(positions - eye, axis=1)
    extra = level.extra_level[rows] / 64
    wanted = level_for_distance(distance, scene.header.reference_distance, extra, len(scene.levels) - 1)
    return rows[wanted >= number]


@pytest.mark.parametrize("view", VECTORS["views"], ids=lambda v: f"{v['file']}-{v['by_distance']}")
def test_gaussians_are_those_of_the_document(view: dict[str, Any]) -> None:
    scene, eye, found = decoded(view["file"].removesuffix(".slps")), np.array(view["eye"]), []
    for number, level in enumerate(scene.levels):
        rows = _rows(scene, number, level, eye, view["by_distance"])
        cloud = expand_slots(scene.header, scene.weights, number, level, rows, eye)
        places = np.array([(number, row, k) for row in rows for k in range(level.slots)]).reshape(-1, 3)
        quaternions = cloud.quaternions / np.linalg.norm(cloud.quaternions, axis=1, keepdims=True)
        table = [places, cloud.means, cloud.scales, quaternions, cloud.opacities[:, None], cloud.colours]
        found.append(np.concatenate(table, axis=1)[cloud.opacities > 0])
    expected, got = np.array(view["gaussians"]), np.concatenate(found)
    assert len(expected) > 4
    np.testing.assert_array_equal(got[:, :3], expected[:, :3])
    tolerance, columns = VECTORS["tolerance"], np.split(np.arange(3, 17), [3, 6, 10, 11])
    for (name, bound), at in zip(tolerance.items(), columns, strict=True):
        size = np.maximum(np.abs(expected[:, at]), 1) if name == "mean" else 1
        size = np.abs(expected[:, at]).max(axis=1, keepdims=True) if name == "scale" else size
        assert (np.abs(got[:, at] - expected[:, at]) <= bound * size).all(), name
