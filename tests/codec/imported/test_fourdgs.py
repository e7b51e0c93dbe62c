"""`.4dgs`: a clip there and back, and one that another program wrote."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from streamlod.client.commands import export
from streamlod.client.recording import decode_frames
from streamlod.codec.export import fourdgs_file
from streamlod.codec.imported import import_files
from streamlod.core.camera import look_at, pinhole
from streamlod.core.errors import InputError
from streamlod.core.scene.expand import expand
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.core.scene.metadata import Metadata
from tests.client.clips import FRAME_NS, states, write_clip

fourdgs = pytest.importorskip("fourdgs", reason="reads and writes .4dgs files: pip install fourdgs")
EYE = np.array([0.0, 0.0, -50.0])


def _shown(cloud: GaussianCloud) -> GaussianCloud:
    rows = np.flatnonzero(cloud.opacities >= 1 / 255)
    return GaussianCloud(*(getattr(cloud, name)[rows] for name in GaussianCloud.__slots__))


def test_the_other_program_reads_what_we_write_at_each_instant(tmp_path: Path) -> None:
    """Positions, opacities, sizes and colours within its quantisation; what stays as it is stands there once."""
    scenes = states(4)
    write_clip(tmp_path / "a.slod", scenes)
    assert "Gaussians over time" in export(tmp_path / "a.slod", 0, "average", "4dgs")
    clip = fourdgs.read(str(tmp_path / "a.4dgs"))
    written, frames = clip.gaussians, [frame.scene for frame in decode_frames(tmp_path / "a.slod")]
    assert written.count < sum(len(expand(scene, EYE)) for scene in frames)
    for number, scene in enumerate(frames):
        wanted, state = expand(scene, EYE), clip.state_at((number + 0.5) * FRAME_NS / 1e9)
        assert len(state["indices"]) == len(wanted)
        means = state["centers"] * [1, -1, -1]
        distance, row = cKDTree(wanted.means).query(means)
        assert distance.max() < 1e-3 * np.ptp(wanted.means, axis=0).max()
        assert np.abs(state["opacity"] - wanted.opacities[row]).mean() < 0.02
        assert np.abs(written.colors[state["indices"], :3] - wanted.colours[row]).mean() < 0.02
    assert clip.duration_sec == pytest.approx(4 * FRAME_NS / 1e9)
    assert clip.header.attributes["coordinate_system"] == "y-up-right-handed"


def test_a_program_that_looks_at_each_frame_sees_that_one(tmp_path: Path) -> None:
    """Times are whole nanoseconds: the third of 30 frames a second begins after 2/30 s."""
    scenes, fps = states(4), 30
    frames = [(round(number * 1e9 / fps) / 1e9, scene) for number, scene in enumerate(scenes)]
    fourdgs_file.write_clip(tmp_path / "a.4dgs", frames, EYE[None], Metadata(), fps)
    clip = fourdgs.read(str(tmp_path / "a.4dgs"))
    for number, scene in enumerate(scenes):
        wanted, means = expand(scene, EYE).means, clip.state_at(number / fps)["centers"] * [1, -1, -1]
        assert len(means) == len(wanted)
        assert cKDTree(wanted).query(means)[0].max() < 1e-3 * np.ptp(wanted, axis=0).max()


def test_there_and_back_shows_the_same(tmp_path: Path) -> None:
    scenes = states(3)
    write_clip(tmp_path / "a.slod", scenes)
    export(tmp_path / "a.slod", 0, "average", "4dgs")
    fps = 1e9 / FRAME_NS
    assert import_files(tmp_path / "a.4dgs", tmp_path / "b.slod", fps).endswith("1 keyframe")
    for scene, frame in zip(scenes, decode_frames(tmp_path / "b.slod"), strict=True):
        wanted, found = _shown(expand(scene, EYE)), _shown(expand(frame.scene, EYE))
        assert len(found) == pytest.approx(len(wanted), abs=3)
        distance = cKDTree(wanted.means).query(found.means)[0]
        assert np.quantile(distance, 0.98) < 2e-3 * np.ptp(wanted.means, axis=0).max()


def _moving(count: int = 50) -> Iterator[tuple[str, np.ndarray]]:
    rng = np.random.default_rng(0)
    yield "positions", rng.normal(0, 1, (count, 3)).astype(np.float32)
    yield "scales", np.full((count, 3), 0.05, np.float32)
    yield "rotations", np.tile(np.array([0, 0, 0, 1], np.float32), (count, 1))
    yield "colors", np.tile(np.array([0.8, 0.4, 0.2, 0.9], np.float32), (count, 1))
    yield "motions", np.tile(np.array([1, 0, 0], np.float32), (count, 1))
    yield "mu_t", np.zeros(count, np.float32)
    yield "sigma_t", np.full(count, np.inf, np.float32)
    yield "win_lo", np.zeros(count)
    yield "win_hi", np.where(np.arange(count) < 10, 0.5, 2.0)


def test_motion_and_lifetimes_of_a_foreign_clip_are_sampled(tmp_path: Path) -> None:
    fourdgs.write(str(tmp_path / "a.4dgs"), fourdgs.GaussianSet(**dict(_moving())), 1.0)
    import_files(tmp_path / "a.4dgs", tmp_path / "a.slod", fps=10)
    clouds = [_shown(expand(frame.scene, EYE)) for frame in decode_frames(tmp_path / "a.slod")]
    assert [len(cloud) for cloud in clouds] == [50] * 5 + [40] * 5
    moved = np.sort(clouds[4].means[:, 0]) - np.sort(clouds[0].means[:, 0])
    np.testing.assert_allclose(moved, 0.4, atol=0.01)


def test_usd_has_time_samples_the_unit_and_the_upright_axis(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="writes OpenUSD: pip install usd-core")
    geometry = pytest.importorskip("pxr.UsdGeom")
    scenes = [replace(state, metadata=Metadata(metres_per_unit=0.5)) for state in states(3)]
    write_clip(tmp_path / "a.slod", scenes)
    export(tmp_path / "a.slod", 0, "average", "usd")
    stage = usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert geometry.GetStageMetersPerUnit(stage) == 0.5
    assert geometry.GetStageUpAxis(stage) == "Y"
    field = next(prim for prim in stage.Traverse() if prim.GetTypeName() == "ParticleField3DGaussianSplat")
    positions = field.GetAttribute("positions")
    times = positions.GetTimeSamples()
    assert len(times) >= 3
    for scene, at in zip(scenes, times, strict=False):
        wanted = expand(scene, EYE)
        found = np.array(positions.Get(at)) * [1, -1, -1]
        assert len(found) == len(wanted)
        assert cKDTree(wanted.means).query(found)[0].max() < 1e-3 * np.ptp(wanted.means, axis=0).max()


def test_cameras_in_usd_see_a_point_where_ours_do(tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="writes OpenUSD: pip install usd-core")
    geometry, gf = pytest.importorskip("pxr.UsdGeom"), pytest.importorskip("pxr.Gf")
    pose = look_at(np.array([1.0, -2, -9]), np.zeros(3), np.array([0.0, 1, 0]))
    camera = pinhole("left one", (80, 70), (40, 35), (96, 64), pose)
    scenes = [replace(state, header=replace(state.header, cameras=(camera,))) for state in states(2)]
    write_clip(tmp_path / "a.slod", scenes)
    export(tmp_path / "a.slod", 0, "average", "usd")
    stage = usd.Stage.Open(str(tmp_path / "a.usdc"))
    (found,) = (geometry.Camera(prim) for prim in stage.Traverse() if prim.GetTypeName() == "Camera")
    assert found.GetPrim().GetDisplayName() == "left one"
    frustum = found.GetCamera(usd.TimeCode.Default()).frustum
    point = np.array([0.7, 0.4, 1.5])
    seen = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(gf.Vec3d(*(point * [1, -1, -1])))
    x, y, z = camera.intrinsics @ (pose @ np.append(point, 1))[:3]
    assert [48 * (1 + seen[0]), 32 * (1 - seen[1])] == pytest.approx([x / z, y / z], abs=1e-3)


def test_a_gltf_snapshot_says_what_it_is(tmp_path: Path) -> None:
    write_clip(tmp_path / "a.slod", states(1))
    export(tmp_path / "a.slod", 0, "average", "glb", tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + length])
    assert "KHR_gaussian_splatting" in content["extensionsUsed"]
    assert "KHR_gaussian_splatting" in content["meshes"][0]["primitives"][0]["extensions"]
    (tmp_path / "cut.glb").write_bytes(data[:-9])
    for name in ("cut.glb", "none.glb"):
        with pytest.raises(InputError, match=name):
            import_files(_existing(tmp_path / name), tmp_path / "b.slod")


def _existing(path: Path) -> Path:
    if not path.exists():
        path.write_bytes(b"glTF")
    return path


def test_what_is_no_such_file_or_has_unknown_axes_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.4dgs").write_bytes(b"no such thing")
    with pytest.raises(InputError, match=r"a\.4dgs"):
        import_files(tmp_path / "a.4dgs", tmp_path / "a.slod")
    options = fourdgs.WriteOptions(metadata={"coordinate_system": "w-up"})
    fourdgs.write(str(tmp_path / "b.4dgs"), fourdgs.GaussianSet(**dict(_moving())), 1.0, options=options)
    with pytest.raises(InputError, match="axes 'w-up'"):
        import_files(tmp_path / "b.4dgs", tmp_path / "b.slod")
    assert not (tmp_path / "b.slod").exists()
