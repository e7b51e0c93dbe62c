"""Snapshots, read by the loaders of three.js under node: glTF with KHR_gaussian_splatting, SPZ and PLY."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.export import bake, write_snapshot
from streamlod.codec.snapshots import FORMATS
from tests.client.web.scenes import make_scene

HERE = Path(__file__).parent
Y_UP = np.array([1, -1, -1])
AXES = {"ply": np.ones(3), "spz": Y_UP, "spz4": Y_UP, "glb": Y_UP}
SIZE_TOLERANCE = {
    "ply": 1e-5,
    "spz": 1 / 15,
    "spz4": 1 / 15,
    "glb": 1e-5,
}  # of covariances: SPZ has 16 log-scales to one


@pytest.mark.parametrize("kind", AXES)
def test_three_js_reads_what_was_written(node: str, tmp_path: Path, kind: str) -> None:
    """Centres, covariances, colours and opacities, in the axes of the format."""
    if not (HERE / "node_modules" / "three").exists():
        pytest.skip("three is not installed: npm install --prefix tests/client/web")
    for package in {"glb": ["fourdgs"], "spz4": ["zstandard"]}.get(kind, []):
        pytest.importorskip(package, reason="such files need streamlod[interchange]")
    scene = make_scene(100, view_dependent=False)
    cloud = bake(scene, scene.header.cameras[0].centre[None])
    path = tmp_path / f"a{FORMATS[kind].suffix}"
    write_snapshot(path, cloud, kind, "frame 0")
    command = [node, "three_reads.mjs", str(path)]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    np.testing.assert_allclose(np.reshape(told["position"], (-1, 3)) * AXES[kind], cloud.means, atol=1e-5)
    w, x, y, z = (cloud.quaternions / np.linalg.norm(cloud.quaternions, axis=1, keepdims=True)).T.astype(np.float64)
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    spread = AXES[kind][:, None] * turn * cloud.scales[:, None, :]
    covariances = (spread @ spread.transpose(0, 2, 1))[:, (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)]
    errors = abs(np.reshape(told["covariance"], (-1, 6)) - covariances).max(axis=1)
    assert (errors / covariances.max(axis=1)).max() < SIZE_TOLERANCE[kind]
    colours = np.concatenate([cloud.colours, cloud.opacities[:, None]], axis=1)
    assert abs(np.reshape(told["color"], (-1, 4)) / 255 - colours).max() < 3 / 255
