"""Snapshots, read back by programs that are not ours: gsply here, splat-transform in the slow test."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from streamlod.codec.export import bake, encode_ply, encode_spz, write_snapshot
from streamlod.core.arrays import Float32
from streamlod.core.errors import InputError
from streamlod.core.scene.expand import expand
from streamlod.core.scene.gaussians import GaussianCloud
from tests.codec.foreign import gsply
from tests.codec.scenes import make_scene

SPLAT_TRANSFORM = "@playcanvas/splat-transform@2.7.1"
HALF_TURN = np.array([1, -1, -1], np.float32)  # SPZ has y up and z backwards; gsply hands its axes on as they are
SH_C0 = 0.28209479177387814


@pytest.fixture
def cloud() -> GaussianCloud:
    rng = np.random.default_rng(0)
    return GaussianCloud(
        means=(3 * rng.normal(size=(300, 3))).astype(np.float32),
        quaternions=rng.normal(size=(300, 4)).astype(np.float32),
        scales=np.exp(rng.normal(-3, 1, (300, 3))).astype(np.float32),
        opacities=rng.uniform(0.01, 0.99, 300).astype(np.float32),
        colours=rng.uniform(0, 1, (300, 3)).astype(np.float32),
    )


def assert_close(found: gsply.GSData, cloud: GaussianCloud, axes: Float32, tolerances: tuple[float, ...]) -> None:
    """Compare means, log scales, colours, opacities and rotations (as 1 - |cos|), each within its tolerance."""
    turned = found.quats * np.append(1, axes)
    unit = cloud.quaternions / np.linalg.norm(cloud.quaternions, axis=1, keepdims=True)
    errors = (
        np.abs(found.means * axes - cloud.means).max(),
        np.abs(found.scales - np.log(cloud.scales)).max(),
        np.abs(found.sh0.reshape(-1, 3) * SH_C0 + 0.5 - cloud.colours).max(),
        np.abs(1 / (1 + np.exp(-found.opacities.reshape(-1))) - cloud.opacities).max(),
        1 - np.abs((turned * unit).sum(axis=1)).min(),
    )
    assert all(error <= limit for error, limit in zip(errors, tolerances, strict=True)), errors


def test_gsply_reads_our_ply(cloud: GaussianCloud, tmp_path: Path) -> None:
    write_snapshot(tmp_path / "a.ply", cloud, "ply", "frame 3")
    assert_close(gsply.plyread(str(tmp_path / "a.ply")), cloud, np.ones(3, np.float32), (0, 1e-6, 1e-6, 1e-6, 1e-6))
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("kind", ["spz", "spz4"])
def test_gsply_reads_our_spz_within_its_quantisation(cloud: GaussianCloud, tmp_path: Path, kind: str) -> None:
    write_snapshot(tmp_path / "a.spz", cloud, kind, "")
    found = gsply.read_spz(str(tmp_path / "a.spz"))
    assert_close(
        found, cloud, HALF_TURN, (2e-6, 1 / 32 + 1e-4, 0.5 / 255 / 0.15 * SH_C0 + 1e-4, 0.5 / 255 + 1e-4, 1e-5)
    )


@pytest.mark.parametrize("count", [0, 1])
def test_small_clouds(cloud: GaussianCloud, tmp_path: Path, count: int) -> None:
    parts = (cloud.means, cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
    small = GaussianCloud(*(part[:count] for part in parts))
    (tmp_path / "a.ply").write_bytes(encode_ply(small, "none"))
    assert f"element vertex {count}\n".encode() in (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.spz").write_bytes(encode_spz(small))
    if count:
        assert len(gsply.read_spz(str(tmp_path / "a.spz")).means) == count


def test_refusals_leave_no_file(cloud: GaussianCloud, tmp_path: Path) -> None:
    far = GaussianCloud(cloud.means * np.float32(1e8), cloud.quaternions, cloud.scales, cloud.opacities, cloud.colours)
    with pytest.raises(InputError, match="does not fit"):
        write_snapshot(tmp_path / "a.spz", far, "spz", "")
    with pytest.raises(InputError, match="not a snapshot format"):
        write_snapshot(tmp_path / "a.obj", cloud, "obj", "")
    with pytest.raises(ValueError, match="one line"):
        encode_ply(cloud, "two\nlines")
    assert list(tmp_path.iterdir()) == []


def test_baked_at_a_camera_is_what_that_camera_sees() -> None:
    scene = make_scene((20, 60))
    centre = scene.header.cameras[0].centre
    baked, seen = bake(scene, centre[None]), expand(scene, centre)
    for name in GaussianCloud.__slots__:
        np.testing.assert_array_equal(getattr(baked, name), getattr(seen, name))


def test_average_lies_between_the_views() -> None:
    scene = make_scene((20, 60))
    centres = np.stack([camera.centre for camera in scene.header.cameras])
    averaged = bake(scene, centres)
    views = [expand(scene, centre) for centre in centres]
    assert len(averaged) >= max(map(len, views))
    seen = np.concatenate([view.opacities for view in views])
    assert averaged.opacities.max() <= seen.max()
    same = bake(scene, np.repeat(centres[:1], 3, axis=0))
    np.testing.assert_allclose(same.colours, views[0].colours, atol=1e-6)
    with pytest.raises(ValueError, match="viewpoint"):
        bake(scene, np.zeros((0, 3)))


@pytest.mark.slow
def test_splat_transform_reads_both_and_they_agree(cloud: GaussianCloud, tmp_path: Path) -> None:
    if shutil.which("npx") is None:
        pytest.skip("no npx here")
    write_snapshot(tmp_path / "a.ply", cloud, "ply", "frame 3")
    write_snapshot(tmp_path / "b.spz", cloud, "spz", "")
    for name, limits in (("a.ply", (1e-6, 1e-5, 1e-5, 1e-5, 1e-5)), ("b.spz", (2e-6, 0.04, 0.005, 0.003, 1e-5))):
        command = ["npx", "--yes", SPLAT_TRANSFORM, "-w", "-q", str(tmp_path / name), str(tmp_path / "out.ply")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
        assert done.returncode == 0, done.stderr
        assert_close(gsply.plyread(str(tmp_path / "out.ply")), cloud, np.ones(3, np.float32), limits)
