"""Compressed PLY, files with another axis up, and damaged files of all kinds."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from streamlod.client.recording import decode_version
from streamlod.codec.export.upright import turned
from streamlod.codec.imported import import_files
from streamlod.codec.snapshots import AXES, FORMATS
from streamlod.core.errors import InputError
from streamlod.core.scene.expand import expand
from streamlod.core.scene.gaussians import GaussianCloud
from tests.codec.foreign import gsply
from tests.codec.imported.clouds import compressed_ply, some_cloud
from tests.codec.imported.test_imported import FAR, _assert_shows
from tests.work import memory


@pytest.mark.parametrize(("with_colours", "harmonics"), [(True, 0), (False, 0), (True, 45)])
def test_a_compressed_ply_shows_its_gaussians(tmp_path: Path, with_colours: bool, harmonics: int) -> None:
    """Of 400 in two chunks, with and without bounds of colours, and with harmonics behind."""
    (tmp_path / "a.compressed.ply").write_bytes(compressed_ply(some_cloud(), with_colours, harmonics))
    import_files(tmp_path / "a.compressed.ply", tmp_path / "a.slod")
    _assert_near(tmp_path / "a.slod", some_cloud())


@pytest.mark.long  # that program compiles its own kernels
def test_a_compressed_ply_of_another_program_is_read(tmp_path: Path) -> None:
    cloud = some_cloud()
    data = gsply.GSData(
        means=cloud.means, scales=np.log(cloud.scales), quats=cloud.quaternions,
        opacities=np.log(cloud.opacities / (1 - cloud.opacities)),
        sh0=(cloud.colours - 0.5) / 0.28209479177387814, shN=np.full((400, 15, 3), 0.1, np.float32),
    )  # fmt: skip
    gsply.plywrite(str(tmp_path / "a.compressed.ply"), data, compressed=True)
    import_files(tmp_path / "a.compressed.ply", tmp_path / "a.slod")
    _assert_near(tmp_path / "a.slod", some_cloud())


def _assert_near(path: Path, cloud: GaussianCloud) -> None:
    """Within the steps of 10 and 11 bits: numbers are matched by the nearest place, and compared one by one."""
    shown = expand(decode_version(path, 0), FAR)
    assert len(shown) == len(cloud)
    rows = np.linalg.norm(shown.means[:, None] - cloud.means, axis=2).argmin(axis=1)
    assert sorted(rows) == list(range(len(cloud)))
    assert np.abs(shown.means - cloud.means[rows]).max() < np.ptp(cloud.means, axis=0).max() / 1000
    np.testing.assert_allclose(shown.opacities, cloud.opacities[rows], atol=0.015)
    np.testing.assert_allclose(shown.colours, cloud.colours[rows], atol=0.015)
    np.testing.assert_allclose(np.log(shown.scales), np.log(cloud.scales[rows]), atol=0.03)
    turns = [q / np.linalg.norm(q, axis=1, keepdims=True) for q in (shown.quaternions, cloud.quaternions[rows])]
    assert (1 - np.abs((turns[0] * turns[1]).sum(axis=1))).max() < 1e-3


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (b"element chunk 2", b"element chunk 1", "too many"),
        (b"element vertex 400", b"element vertex 19000000", "cut off"),
        (b"element chunk 2", b"element chunk 4000000000", "at most"),
        (b"property uint packed_scale", b"property float packed_scale", "no integers"),
        (b"property uint packed_scale", b"property uint scale", "lacks packed_scale"),
        (b"property float min_x", b"property float low_x", "lacks min_x"),
        (b"element chunk", b"element chonk", "lacks min_x"),
        (b"end_header\n", b"element sh 1\nproperty uchar n\nend_header\n", None),
    ],
)
def test_a_compressed_ply_that_is_no_such_is_refused_by_name(
    tmp_path: Path, old: bytes, new: bytes, fault: str | None
) -> None:
    (tmp_path / "a.ply").write_bytes(compressed_ply(some_cloud()).replace(old, new, 1))
    with memory() as taken:
        if fault is None:
            import_files(tmp_path / "a.ply", tmp_path / "a.slod")
        else:
            with pytest.raises(InputError, match=fault):
                import_files(tmp_path / "a.ply", tmp_path / "a.slod")
    assert taken.peak_bytes < 20 << 20


def test_more_packed_gaussians_than_chunks_have_room_for_are_refused(tmp_path: Path) -> None:
    data = compressed_ply(some_cloud(count=200))
    data = data.replace(b"element vertex 200", b"element vertex 400") + bytes(200 * 16)
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(InputError, match="400 packed Gaussians, and 1 chunks"):
        import_files(tmp_path / "a.ply", tmp_path / "a.slod")


def test_chunks_whose_bounds_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    head, mark, body = compressed_ply(some_cloud()).partition(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(head + mark + struct.pack("<f", np.nan) + body[4:])
    assert "144 Gaussians" in import_files(tmp_path / "a.ply", tmp_path / "a.slod")


@pytest.mark.parametrize("up", AXES)
def test_the_axis_that_points_up_in_the_file_points_up_in_the_scene(up: str) -> None:
    """Turned, not mirrored, with what each Gaussian's longest axis lies along."""
    sign, axis = (-1 if up[0] == "-" else 1), "xyz".index(up[-1])
    means = np.concatenate([np.eye(3), sign * np.eye(3)[axis : axis + 1]]).astype(np.float32)
    ends = np.ones(4, np.float32)
    scales = np.full((4, 3), 0.1, np.float32)
    scales[3, axis] = 1
    cloud = GaussianCloud(means, np.tile(np.float32([1, 0, 0, 0]), (4, 1)), scales, ends, np.ones((4, 3), np.float32))
    there = turned(cloud, "-y", up)
    np.testing.assert_allclose(there.means[3], [0, -1, 0], atol=1e-6)
    assert np.linalg.det(there.means[:3]) == pytest.approx(1)
    w, x, y, z = there.quaternions[3] / np.linalg.norm(there.quaternions[3])
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(np.abs(turn[:, axis]), [0, 1, 0], atol=1e-6)
    back = turned(there, up, "-y")
    np.testing.assert_allclose(back.means, means, atol=1e-6)


@pytest.mark.parametrize(("name", "same", "other"), [("ply", "-y", "y"), ("spz", "y", "-y")])
def test_import_turns_what_has_another_axis_up_than_its_format(
    tmp_path: Path, name: str, same: str, other: str
) -> None:
    path = tmp_path / f"a.{name}"
    path.write_bytes(FORMATS[name].encode(some_cloud(), "x"))
    half = turned(some_cloud(), "-y", "y")
    for up, cloud in ((None, some_cloud()), (same, some_cloud()), (other, half)):
        import_files(path, tmp_path / "a.slod", up=up)
        _assert_shows(decode_version(tmp_path / "a.slod", 0), cloud, 0.04)


def test_a_clip_with_axes_that_are_not_known_is_read_when_told_which_is_up(tmp_path: Path) -> None:
    fourdgs = pytest.importorskip("fourdgs", reason="such files need streamlod[interchange]")
    cloud, count = some_cloud(), 400
    parts = fourdgs.GaussianSet(
        positions=cloud.means, scales=cloud.scales, rotations=np.roll(cloud.quaternions, -1, axis=1),
        colors=np.concatenate([cloud.colours, cloud.opacities[:, None]], axis=1),
        motions=np.zeros((count, 3), np.float32), mu_t=np.zeros(count, np.float32),
        sigma_t=np.full(count, np.inf, np.float32), win_lo=np.zeros(count), win_hi=np.full(count, np.inf),
    )  # fmt: skip
    options = fourdgs.WriteOptions(metadata={"coordinate_system": "z-up-right-handed"})
    fourdgs.write(str(tmp_path / "a.4dgs"), parts, 1.0, options=options)
    with pytest.raises(InputError, match="say with --up which"):
        import_files(tmp_path / "a.4dgs", tmp_path / "a.slod", fps=1)
    import_files(tmp_path / "a.4dgs", tmp_path / "a.slod", fps=1, up="z")
    _assert_near(tmp_path / "a.slod", turned(cloud, "-y", "z"))
