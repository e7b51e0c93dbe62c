"""Gaussians of other programs as streams: what is shown is what was in the files, and frames become changes."""

from __future__ import annotations

import gzip
import itertools
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from streamlod.client.inspection import describe_file
from streamlod.client.recording import decode_frames, decode_version
from streamlod.codec.container import SlodReader
from streamlod.codec.decoder import SceneDecoder
from streamlod.codec.imported import import_files, is_importable
from streamlod.codec.packet.packet import PacketKind
from streamlod.codec.snapshots import FORMATS, format_of
from streamlod.core.errors import InputError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.expand import expand
from streamlod.core.scene.gaussians import GaussianCloud
from streamlod.server.cli.commands import playable
from tests.codec.foreign import gsply
from tests.codec.imported.clouds import some_cloud
from tests.work import memory

FAR = np.array([0.0, 0.0, -100.0])


def _write(folder: Path, clouds: list[GaussianCloud], name: str = "ply") -> Path:
    folder.mkdir(exist_ok=True)
    for number, cloud in enumerate(clouds):
        (folder / f"frame_{number}{FORMATS[name].suffix}").write_bytes(FORMATS[name].encode(cloud, "a test"))
    return folder


def _assert_shows(scene: Scene, cloud: GaussianCloud, scale: float) -> None:
    shown = expand(scene, FAR)
    distance, row = cKDTree(cloud.means).query(shown.means)
    assert sorted(row) == list(range(len(cloud)))
    assert distance.max() < np.ptp(cloud.means, axis=0).max() / 2**16
    np.testing.assert_allclose(shown.opacities, cloud.opacities[row], atol=0.012)
    np.testing.assert_allclose(shown.colours, cloud.colours[row], atol=0.012)
    np.testing.assert_allclose(np.log(shown.scales), np.log(cloud.scales[row]), atol=scale)
    turned, wanted = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (shown.quaternions, cloud.quaternions[row]))
    assert (1 - np.abs((turned * wanted).sum(axis=1))).max() < 1e-3


@pytest.mark.parametrize("name", [each.name for each in FORMATS.values() if each.decode is not None])
def test_a_file_shows_its_gaussians_and_stays_alive(tmp_path: Path, name: str) -> None:
    for package in {"glb": ["fourdgs"], "spz4": ["zstandard"]}.get(name, []):
        pytest.importorskip(package, reason="such files need streamlod[interchange]")
    path = _write(tmp_path, [some_cloud()], name) / f"frame_0{FORMATS[name].suffix}"
    assert import_files(path, tmp_path / "a.slod") == f"{tmp_path / 'a.slod'}: 1 frame of 400 Gaussians, 1 keyframe"
    _assert_shows(decode_version(tmp_path / "a.slod", 0), some_cloud(), 0.04)
    with SlodReader(tmp_path / "a.slod") as reader:
        assert [entry.time_ns for entry in reader.entries[:3]] == [0, 10**9, 2 * 10**9]
        assert sum(entry.size_bytes for entry in reader.entries[1:]) < 10_000
    assert "title: frame_0" in describe_file(tmp_path / "a.slod")


def test_a_sequence_becomes_changes_in_natural_order(tmp_path: Path) -> None:
    clouds = [some_cloud(frame) for frame in range(12)]
    folder = _write(tmp_path / "take", clouds)
    (folder / "notes.txt").write_text("not a frame")
    (folder / ".hidden.ply").write_text("not a frame")
    assert "12 frames of 400 Gaussians, 1 keyframe" in import_files(folder, tmp_path / "a.slod", fps=24)
    frames = list(decode_frames(tmp_path / "a.slod"))
    for cloud, frame in zip(clouds, frames, strict=True):
        _assert_shows(frame.scene, cloud, 0.02)
    assert [round(frame.time_ns * 24 / 1e9) for frame in frames] == list(range(12))


def test_another_number_of_gaussians_or_too_much_growth_makes_a_keyframe(tmp_path: Path) -> None:
    clouds = [some_cloud(), some_cloud(count=300), some_cloud(1, 300), some_cloud(2, 300, growth=0.6)]
    import_files(_write(tmp_path / "take", clouds), tmp_path / "a.slod")
    with SlodReader(tmp_path / "a.slod") as reader:
        kinds = [entry.kind for entry in reader.entries]
    assert kinds == [PacketKind.KEY, PacketKind.KEY, PacketKind.CHANGE, PacketKind.KEY]
    for cloud, frame in zip(clouds, decode_frames(tmp_path / "a.slod"), strict=True):
        _assert_shows(frame.scene, cloud, 0.02)


def test_those_that_show_most_are_kept_and_the_rest_told(tmp_path: Path) -> None:
    cloud = some_cloud()
    path = _write(tmp_path, [cloud]) / "frame_0.ply"
    assert "of 100 Gaussians, of 400 the 100 that show most" in import_files(path, tmp_path / "a.slod", most=100)
    shown = expand(decode_version(tmp_path / "a.slod", 0), FAR)
    sizes = np.sort(cloud.scales, axis=1)
    least = np.sort(cloud.opacities * sizes[:, 1] * sizes[:, 2])[-100]
    sizes = np.sort(shown.scales, axis=1)
    assert (shown.opacities * sizes[:, 1] * sizes[:, 2]).min() > 0.9 * least


def test_levels_hold_what_shows_most_first(tmp_path: Path) -> None:
    import_files(_write(tmp_path, [some_cloud()]) / "frame_0.ply", tmp_path / "a.slod")
    scene = decode_version(tmp_path / "a.slod", 0)
    assert [len(level) for level in scene.levels] == [25, 75, 300]
    areas = [np.median(np.sort(level.scaling[:, 3:], axis=1)[:, 1:].sum(axis=1)) for level in scene.levels]
    assert all(coarse > fine for coarse, fine in itertools.pairwise(areas))


@pytest.mark.long
def test_files_of_another_program_are_read(tmp_path: Path) -> None:
    """With spherical harmonics of degree 3, whose higher bands are left out; both versions of SPZ packing."""
    cloud, rng = some_cloud(), np.random.default_rng(0)
    data = gsply.GSData(
        means=cloud.means, scales=np.log(cloud.scales), quats=cloud.quaternions,
        opacities=np.log(cloud.opacities / (1 - cloud.opacities)),
        sh0=(cloud.colours - 0.5) / 0.28209479177387814, shN=rng.normal(0, 0.1, (400, 15, 3)).astype(np.float32),
    )  # fmt: skip
    gsply.plywrite(str(tmp_path / "a.ply"), data)
    import_files(tmp_path / "a.ply", tmp_path / "a.slod")
    _assert_shows(decode_version(tmp_path / "a.slod", 0), cloud, 0.02)
    gsply.write_spz(tmp_path / "b.spz", data, version=3)
    import_files(tmp_path / "b.spz", tmp_path / "b.slod")
    assert len(expand(decode_version(tmp_path / "b.slod", 0), FAR)) == 400


def test_files_that_are_damaged_or_something_else_are_refused_by_name(tmp_path: Path) -> None:
    ply, spz, spz4 = (FORMATS[name].encode(some_cloud(), "x") for name in ("ply", "spz", "spz4"))
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, 4_000_000_000, 0, 12, 0, 0)
    points = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"
    wrong = {
        "cut.ply": ply[:-1], "points.ply": points, "empty.ply": b"", "text.ply": b"hello\n",
        "cut4.spz": spz4[:-1], "head4.spz": spz4[:20], "table4.spz": spz4[:60], "zeros4.spz": spz4[:112] + bytes(5000),
        "sizes4.spz": spz4[:40] + struct.pack("<Q", 1 << 40) + spz4[48:], "few4.spz": spz4[:15] + b"\4" + spz4[16:],
        "huge4.spz": spz4[:8] + b"\xff" * 4 + spz4[12:], "far4.spz": spz4[:16] + b"\xff" * 4 + spz4[20:],
        "none3.spz": gzip.compress(head[:8] + bytes(8)), "none4.spz": FORMATS["spz4"].encode(some_cloud(count=0), ""),
        "cut.spz": spz[: len(spz) // 2], "none.spz": b"", "huge.spz": gzip.compress(head), "plain.spz": head,
        "none.ply": ply.replace(b"vertex 400", b"vertex 0").partition(b"end_header\n")[0] + b"end_header\n",
    }  # fmt: skip
    for name, content in wrong.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            import_files(tmp_path / name, tmp_path / "out.slod")
    assert not (tmp_path / "out.slod").exists()
    with pytest.raises(InputError, match="no file of Gaussians"):
        import_files(tmp_path / "absent.obj", tmp_path / "out.slod")


def test_a_bomb_of_zeros_is_not_unpacked(tmp_path: Path) -> None:
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 0, 12, 0, 0)
    (tmp_path / "bomb.spz").write_bytes(gzip.compress(head + bytes(200 << 20), compresslevel=1))
    with memory() as taken:
        import_files(tmp_path / "bomb.spz", tmp_path / "a.slod")
    assert taken.peak_bytes < 20 << 20


def test_extensions_and_spherical_harmonics_of_spz_4_are_passed_over(tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard", reason="SPZ 4 needs streamlod[interchange]")
    data = FORMATS["spz4"].encode(some_cloud(), "")
    head, table, streams = bytearray(data[:32]), data[32:112], data[112:]
    head[12], head[14], head[15] = 1, 2, 6  # degree, flag of extensions, streams
    struct.pack_into("<I", head, 16, 32 + 12)
    bands = zstandard.ZstdCompressor().compress(bytes(400 * 9))
    (tmp_path / "a.spz").write_bytes(head + bytes(12) + table + struct.pack("<QQ", len(bands), 3600) + streams + bands)
    import_files(tmp_path / "a.spz", tmp_path / "a.slod")
    _assert_shows(decode_version(tmp_path / "a.slod", 0), some_cloud(), 0.04)


def test_numbers_that_are_none_and_strays_far_away_spoil_nothing(tmp_path: Path) -> None:
    cloud = some_cloud()
    means = cloud.means.copy()
    means[3], means[7] = np.nan, (1e30, 0, 0)
    strange = replace(cloud, means=means)
    import_files(_write(tmp_path, [strange]) / "frame_0.ply", tmp_path / "a.slod")
    shown = expand(decode_version(tmp_path / "a.slod", 0), FAR)
    assert len(shown) == 398
    assert cKDTree(cloud.means).query(shown.means)[0].max() < 1e-3


def test_the_ends_of_logarithms_are_kept(tmp_path: Path) -> None:
    """Opacities of 0 and 1, and flat Gaussians; a comment in another language does no harm."""
    cloud = some_cloud()
    data = FORMATS["ply"].encode(cloud, "a test").replace(b"comment a test", "comment gefüllt".encode())
    head, _, body = data.partition(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(400, 17).copy()
    rows[:2, 9], rows[2, 12] = (np.inf, -np.inf), -np.inf
    (tmp_path / "a.ply").write_bytes(head + b"end_header\n" + rows.tobytes())
    import_files(tmp_path / "a.ply", tmp_path / "a.slod")
    shown = expand(decode_version(tmp_path / "a.slod", 0), FAR)
    distance, row = cKDTree(shown.means).query(cloud.means[:3])
    assert (distance[[0, 2]] < 1e-3).all()
    assert shown.opacities[row[0]] > 0.99
    assert shown.scales[row[2], 2] < 1e-7


def test_a_file_that_is_served_is_made_once_and_again_when_it_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = _write(tmp_path / "take", [some_cloud()]) / "frame_0.ply"
    made = playable(path)
    decoder = SceneDecoder()
    with SlodReader(made) as reader:
        decoder.push(reader.read(0))
    assert decoder.scene is not None
    assert decoder.scene.anchor_count == 400
    assert playable(path) == made
    assert playable(tmp_path / "take") != made
    path.write_bytes(FORMATS["ply"].encode(some_cloud(count=90), "x"))
    assert playable(path) != made
    assert playable(made) == made


@pytest.mark.parametrize("content", [b"", b"Notes on filming\n", b"SLOD\x02"])
def test_what_cannot_be_played_is_refused_before_the_server_starts(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "notes.txt"
    with pytest.raises(InputError, match="does not exist"):
        playable(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match="cannot be played"):
        playable(path)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_any_unit_will_do(tmp_path: Path, unit: float) -> None:
    cloud = some_cloud()
    other = replace(cloud, means=cloud.means * np.float32(unit), scales=cloud.scales * np.float32(unit))
    import_files(_write(tmp_path, [other]) / "frame_0.ply", tmp_path / "a.slod")
    shown = expand(decode_version(tmp_path / "a.slod", 0), FAR * unit)
    assert len(shown) == 400
    assert cKDTree(other.means).query(shown.means)[0].max() < max(1e-4 * unit, 3e-7)
    far = replace(cloud, means=cloud.means * np.float32(1e10))
    with pytest.raises(InputError, match="cannot be made a stream"):
        import_files(_write(tmp_path, [far]) / "frame_0.ply", tmp_path / "b.slod")


def test_names_are_told_apart_by_their_suffix(tmp_path: Path) -> None:
    assert format_of(Path("A.PLY")) is FORMATS["ply"]
    assert format_of(Path("a.slod")) is None
    assert not is_importable(tmp_path)
