"""Files of points: what is read, and what is refused."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.errors import InputError
from streamlod.core.initialise import read_points

POSITIONS = np.array([[0, 1, 2], [3, 4, 5], [-1, -2, 0.5]], np.float32)
COLOURS = np.array([[0, 51, 255], [255, 0, 0], [102, 102, 102]], np.uint8)
VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
PROPERTIES = "".join(f"property float {n}\n" for n in "xyz") + "".join(
    f"property uchar {n}\n" for n in ("red", "green", "blue")
)


def ply(kind: str, body: bytes, count: int = 3, properties: str = PROPERTIES, after: str = "") -> bytes:
    head = f"ply\nformat {kind} 1.0\ncomment by hand\nelement vertex {count}\n{properties}{after}end_header\n"
    return head.encode() + body


def binary_body(order: str = "<") -> bytes:
    table = np.zeros(3, VERTEX.newbyteorder(order))
    for axis, name in enumerate("xyz"):
        table[name] = POSITIONS[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        table[name] = COLOURS[:, channel]
    return table.tobytes()


ASCII = b"".join(
    (" ".join(map(str, [*p.tolist(), *c.tolist()])) + "\n").encode() for p, c in zip(POSITIONS, COLOURS, strict=True)
)


@pytest.mark.parametrize(
    ("kind", "body"),
    [("ascii", ASCII), ("binary_little_endian", binary_body()), ("binary_big_endian", binary_body(">"))],
)
def test_ply_is_read(tmp_path: Path, kind: str, body: bytes) -> None:
    path = tmp_path / "points.ply"
    path.write_bytes(ply(kind, body))
    points = read_points(path)
    np.testing.assert_array_equal(points.positions, POSITIONS)
    np.testing.assert_allclose(points.colours, COLOURS / 255, atol=1e-6)


def test_faces_after_the_vertices_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    faces = "element face 1\nproperty list uchar int vertex_indices\n"
    path.write_bytes(ply("binary_little_endian", binary_body() + bytes(13), after=faces))
    assert len(read_points(path)) == 3


@pytest.mark.parametrize(
    ("kind", "body"), [("ascii", b"7 8\n" + ASCII), ("binary_little_endian", b"\7\0\b\0" + binary_body())]
)
def test_elements_before_the_vertices_are_passed_over(tmp_path: Path, kind: str, body: bytes) -> None:
    path = tmp_path / "cloud.ply"
    other = b"element sensor 2\nproperty short number\nelement"
    path.write_bytes(ply(kind, body).replace(b"element", other, 1))
    np.testing.assert_array_equal(read_points(path).positions, POSITIONS)


def test_splat_colours_come_from_band_zero(tmp_path: Path) -> None:
    names = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2")
    path = tmp_path / "splats.ply"
    body = np.array([[1, 2, 3, 0, 1, -1]], "<f4").tobytes()
    path.write_bytes(ply("binary_little_endian", body, 1, "".join(f"property float {n}\n" for n in names)))
    np.testing.assert_allclose(read_points(path).colours, [[0.5, 0.7820948, 0.2179052]], atol=1e-6)


def test_npz_is_read(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    np.savez_compressed(path, positions=np.asfortranarray(POSITIONS, np.float64), colours=COLOURS)
    points = read_points(path)
    np.testing.assert_array_equal(points.positions, POSITIONS)
    np.testing.assert_allclose(points.colours, COLOURS / 255, atol=1e-6)


def test_points_without_colour_are_grey(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    np.savez(path, xyz=POSITIONS)
    assert (read_points(path).colours == 0.5).all()


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "not a PLY"),
        (b"plyx\n", "not a PLY"),
        (b"ply\n" + b"comment \n" * 10_000, "too long"),
        (ply("binary_middle_endian", b""), "another format"),
        (ply("ascii", b"").replace(b"vertex", b"chunk"), "no vertices"),
        (ply("ascii", b"1\n", 1, "property uint packed_position\n"), "compressed PLY"),
        (ply("ascii", ASCII).replace(b"element", b"element list 1\nproperty list uchar int x\nelement", 1), "scalar"),
        (ply("ascii", ASCII).replace(b"element", b"element rows 4\nproperty int n\nelement", 1), "cut off"),
        (ply("ascii", ASCII).replace(b"element", b"element rows 1\nelement", 1), "names no property"),
        (ply("binary_little_endian", binary_body()[:-1]), "cut off"),
        (ply("binary_little_endian", binary_body() + b"!"), "too many"),
        (ply("binary_little_endian", b"", 10**11), "at most"),
        (ply("binary_little_endian", b"", 19_000_000), "cut off"),
        (ply("ascii", ASCII[:-6]), "cut off"),
        (ply("ascii", ASCII.replace(b"4.0", b"four")), "not made of numbers"),
        (ply("ascii", ASCII.replace(b"4.0", b"nan")), "not finite"),
        (ply("ascii", ASCII.replace(b"4.0", b"1e99")), "not finite"),
        (ply("ascii", b"1 2 3\n", 3, "property list uchar int x\n"), "not a scalar"),
        (ply("ascii", b"1\n1\n1\n", 3, "property float x\n"), "lack"),
        (ply("ascii", b"", 0), "no points"),
    ],
)
def test_bad_ply_is_refused(tmp_path: Path, data: bytes, fault: str) -> None:
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    with pytest.raises(InputError, match=fault):
        read_points(path)


def test_ply_cut_at_any_byte_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.ply"
    whole = ply("binary_little_endian", binary_body())
    for end in range(len(whole)):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError):
            read_points(path)


def test_bad_npz_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    good = io.BytesIO()
    np.savez_compressed(good, positions=POSITIONS)
    whole = good.getvalue()
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError):
            read_points(path)
    for arrays, fault in (
        ({"other": POSITIONS}, "no array named positions"),
        ({"positions": POSITIONS[:, :2]}, "shape"),
        ({"positions": np.array([[{}, 1, 2]], object)}, "floats"),
        ({"positions": POSITIONS, "colours": COLOURS[:2]}, "2 colours"),
        ({"positions": np.full_like(POSITIONS, np.inf)}, "not finite"),
    ):
        np.savez(path, **arrays)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=fault):
            read_points(path)


def test_npz_header_that_announces_too_much_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "huge.npz"
    member = io.BytesIO()
    np.lib.format.write_array_header_1_0(member, {"descr": "<f4", "fortran_order": False, "shape": (19_000_000, 3)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("positions.npy", member.getvalue())
    with pytest.raises(InputError, match="size"):
        read_points(path)
