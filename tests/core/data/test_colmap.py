"""COLMAP models in binary and text, with pictures of one instant and of many."""

from __future__ import annotations

import logging
import os
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from streamlod.core.data.colmap.model import read_model, read_points
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from tests.core.data.writers import (
    COLMAP_MODELS,
    picture,
    read_back,
    rig,
    write_colmap_binary,
    write_colmap_text,
    write_picture,
)

NAMES = ("cam00", "cam02", "cam10")
POINTS = np.array([[0.5, -1, 2, 255, 128, 0], [1, 2, 3, 10, 20, 30]])
Writer = Callable[..., None]
both_formats = pytest.mark.parametrize("write", [write_colmap_binary, write_colmap_text], ids=["binary", "text"])


def _one_instant(folder: Path, write: Writer, images: str = "images") -> tuple[Camera, ...]:
    """In the model's file, cameras are not in the order of their names."""
    cameras = rig(NAMES)
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in cameras]
    write(folder / "sparse" / "0", entries[::-1], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(folder / images / f"{name}.png", picture(index, 0))
    return cameras


@both_formats
def test_one_instant(tmp_path: Path, write: Writer) -> None:
    cameras = _one_instant(tmp_path, write)
    dataset = open_dataset(tmp_path)
    assert (dataset.layout, dataset.names, dataset.frame_count, dataset.skipped) == ("colmap", NAMES, 1, ())
    for found, wanted in zip(dataset.cameras, cameras, strict=True):
        np.testing.assert_allclose(found.intrinsics, wanted.intrinsics)
        np.testing.assert_allclose(found.world_to_camera, wanted.world_to_camera, atol=1e-12)
    (frame,) = dataset.frames()
    np.testing.assert_array_equal(frame.images, [picture(index, 0) for index in range(3)])
    cloud = dataset.points()
    assert cloud is not None
    np.testing.assert_allclose(cloud.positions, POINTS[:, :3])
    np.testing.assert_allclose(cloud.colours, POINTS[:, 3:] / 255, atol=1e-6)


@both_formats
@pytest.mark.parametrize("model", COLMAP_MODELS)
def test_every_camera_model(tmp_path: Path, write: Writer, model: str) -> None:
    kept = {"SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4, "FULL_OPENCV": 5}.get(model, 0)
    distortion = np.array([0.01, -0.02, 0.003, -0.004, 0.005]) * (np.arange(5) < kept)
    camera = replace(rig(["a"])[0], distortion=distortion)
    write(tmp_path, [("a.png", camera, model)], POINTS)
    read = read_model(tmp_path)
    found = read.camera_of(read.images[0], "a")
    np.testing.assert_allclose(found.distortion, distortion)
    np.testing.assert_allclose(found.intrinsics, camera.intrinsics)


@pytest.mark.parametrize("damage", ["cut", "garbage", "empty", "no pixels"])
def test_a_damaged_picture_costs_one_camera_one_instant(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    for instant in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{instant:04d}" / f"{name}.png", picture(index, instant))
    bad = tmp_path / "frames" / "0001" / "cam02.png"
    whole = bad.read_bytes()
    spoilt = bytearray(whole)
    spoilt[whole.index(b"IDAT") + 4 : whole.index(b"IDAT") + 44] = bytes(40)
    bad.write_bytes({"cut": whole[:-500], "garbage": b"x" * 500, "empty": b"", "no pixels": bytes(spoilt)}[damage])
    frames = list(open_dataset(tmp_path).frames())
    assert [frame.present.tolist() for frame in frames] == [[True] * 3, [True, False, True], [True] * 3]
    np.testing.assert_array_equal(frames[1].images[2], picture(2, 1))
    assert [record.message.count("0001/cam02.png") for record in caplog.records if "missing at" in record.message] == [
        1
    ]


def test_reduced_pictures_scale_the_calibration(tmp_path: Path) -> None:
    large = rig(NAMES, (192, 128))
    write_colmap_binary(tmp_path / "sparse", [(f"{c.name}.png", c, "PINHOLE") for c in large], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "images_2" / f"{name}.png", picture(index, 0))
    dataset = open_dataset(tmp_path)
    np.testing.assert_allclose(dataset.cameras[0].intrinsics[:2], large[0].intrinsics[:2] / 2)


def test_missing_pictures_are_skipped_counted_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "images" / "cam02.png").unlink()
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (("cam00", "cam10"), ("cam02.png",))
    assert "1 pictures of the model are missing: cam02.png" in caplog.text


@pytest.mark.parametrize("layout", ["frame{:06d}/images", "frame{:06d}", "colmap_{}/images"])
def test_a_folder_an_instant(tmp_path: Path, layout: str) -> None:
    for t in range(11):  # more than ten: sorted as numbers
        folder = tmp_path / layout.format(t)
        for index, name in enumerate(NAMES):
            write_picture(folder / f"{name}.png", picture(index, t))
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / layout.format(0).split("/")[0] / "sparse" / "0", entries, POINTS)
    (tmp_path / layout.format(4) / "cam02.png").unlink()
    dataset = open_dataset(tmp_path)
    assert (dataset.frame_count, dataset.names) == (11, NAMES)
    for frame in dataset.frames(2):
        assert frame.present.tolist() == [True, frame.index != 4, True]
        for index in np.flatnonzero(frame.present):
            assert read_back(frame.images[index]) == (index, frame.index)
        assert frame.images[~frame.present].sum() == 0


def test_a_folder_frames_beside_the_model(tmp_path: Path) -> None:
    entries = [(f"{camera.name}.jpg", camera, "PINHOLE") for camera in rig(NAMES)]  # the pictures are .png
    write_colmap_text(tmp_path / "sparse" / "0", entries, POINTS)
    for t in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{t:04d}" / f"{name}.png", picture(index, t))
    dataset = open_dataset(tmp_path)
    assert [read_back(frame.images[2]) for frame in dataset.frames()] == [(2, 0), (2, 1), (2, 2)]


def test_a_number_without_pictures_leaves_a_gap_in_time(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for t in (7, 8, 11):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{t:04d}" / f"{name}.png", picture(index, t))
    (tmp_path / "frames" / "0009").mkdir()  # nothing was copied into it
    seen = [(frame.index, frame.time_ns, read_back(frame.images[2])) for frame in open_dataset(tmp_path).frames()]
    assert seen == [(0, 0, (2, 7)), (1, 33333333, (2, 8)), (2, 133333333, (2, 11))]
    assert "2 instants have no pictures, after 0008" in caplog.text


@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_a_binary_model_cut_at_any_byte_is_refused(tmp_path: Path, stem: str) -> None:
    write_colmap_binary(tmp_path, [(f"{c.name}.png", c, "OPENCV") for c in rig(NAMES[:2])], POINTS)
    path = tmp_path / f"{stem}.bin"
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=rf"{stem}\.bin: "):
            read_model(tmp_path)


def test_points_cut_at_any_byte_are_refused(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, [], POINTS)
    path = tmp_path / "points3D.bin"
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"points3D\.bin: "):
            read_points(tmp_path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_counts_are_not_believed(tmp_path: Path, stem: str) -> None:
    write_colmap_binary(tmp_path, [("a.png", rig(["a"])[0], "PINHOLE")], POINTS)
    path = tmp_path / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", 2**62) + path.read_bytes()[8:])
    with pytest.raises(InputError, match="claims 4611686018427387904 records"):
        read_points(tmp_path) if stem == "points3D" else read_model(tmp_path)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cameras.txt", "PINHOLE", "OPENCV_FISHEYE", r"cameras\.txt: camera model OPENCV_FISHEYE is not supported"),
        ("cameras.txt", "80.0", "eighty", r"cameras\.txt: line 2: "),
        ("cameras.txt", "80.0", "", r"cameras\.txt: line 2: PINHOLE has 4 parameters, not 2"),
        ("cameras.txt", "80.0", "-80.0", "camera a: focal length must be positive"),
        ("cameras.txt", "80.0", "nan", "camera a: its intrinsics"),
        ("cameras.txt", "\n1 ", "\n9 ", "image a.png: was taken by camera 1, which does not exist"),
        ("cameras.txt", "80.0 48.0", "0.8 0.5", "camera a: its focal length is 0.8 for pictures of 96x64"),
        ("images.txt", " a.png", "", r"images\.txt: line 2: the picture's name is missing"),
        (
            "images.txt",
            "\n1 ",
            "\n1 7 0 0 0 0 0 4 1 a.png\n\n# ",
            r"images\.txt: image a\.png: its quaternion has length",
        ),
        ("images.txt", "\n1 ", "\n1 nan ", r"images\.txt: "),
    ],
)
def test_faults_in_text_models_are_named(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_colmap_text(tmp_path / "sparse", [("a.png", rig(["a"])[0], "PINHOLE")], POINTS)
    write_picture(tmp_path / "images" / "a.png", picture(0, 0))
    path = tmp_path / "sparse" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        open_dataset(tmp_path)


def test_names_that_lead_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    write_picture(tmp_path / "secret.png", picture(0, 0))
    write_picture(tmp_path / "data" / "images" / "b.png", picture(0, 0))
    entries = [("../../secret.png", rig(["a"])[0], "PINHOLE"), ("b.png", rig(["b"])[0], "PINHOLE")]
    write_colmap_binary(tmp_path / "data" / "sparse", entries, POINTS)
    assert open_dataset(tmp_path / "data").names == ("b",)


def test_pictures_may_be_links_and_one_that_leads_to_itself_is_missing(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    images = tmp_path / "images"
    (images / "cam00.png").rename(tmp_path / "elsewhere.png")
    (images / "cam00.png").symlink_to(tmp_path / "elsewhere.png")
    (images / "cam02.png").unlink()
    (images / "cam02.png").symlink_to("cam02.png")
    dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (("cam00", "cam10"), ("cam02.png",))
    assert read_back(next(iter(dataset.frames())).images[0]) == (0, 0)


@both_formats
def test_a_picture_that_a_model_places_twice_is_refused(tmp_path: Path, write: Writer) -> None:
    _one_instant(tmp_path, write)
    write(tmp_path / "sparse" / "0", [("cam00.png", camera, "PINHOLE") for camera in rig(NAMES)], POINTS)
    with pytest.raises(InputError, match=r"sparse/0: places pictures twice: cam00\.png$"):
        open_dataset(tmp_path)


def test_points_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, [], np.concatenate([POINTS, [[np.nan, 0, 0, 0, 0, 0], [1e300, 0, 0, 0, 0, 0]]]))
    assert len(read_points(tmp_path)) == 2
    write_colmap_binary(tmp_path, [], POINTS[:0])
    assert len(read_points(tmp_path)) == 0


@pytest.mark.parametrize(("downscale", "size"), [(1, (1345, 1008)), (2, (672, 504))])
def test_flame_steak(real_data: Path, downscale: int, size: tuple[int, int]) -> None:
    """Real N3DV pictures have the points' colours where the points project, and not half a pixel beside."""
    dataset = open_dataset(real_data / "flame_steak_frame0", downscale=downscale)
    assert dataset.names == tuple(f"cam{number:02d}" for number in range(21))
    assert {(camera.width, camera.height) for camera in dataset.cameras} == {size}
    cloud = dataset.points()
    assert cloud is not None
    assert len(cloud) == 7298
    dataset = dataset.select(["cam00", "cam07", "cam20"])
    (frame,) = dataset.frames()
    pairs = list(zip(dataset.cameras, frame.images, strict=True))

    def difference(across: float, down: float) -> float:
        return float(np.mean([_colour_difference(camera, image, cloud, (across, down)) for camera, image in pairs]))

    there = difference(0, 0)
    assert there < 0.08
    for shift in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)):
        assert difference(*shift) > there + 0.001


def _colour_difference(camera: Camera, image: UInt8, cloud: PointCloud, shift: tuple[float, float]) -> float:
    points = cloud.positions @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = points @ camera.intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:] + shift
    inside = (
        (points[:, 2] > 0) & (pixels > 2).all(axis=1) & (pixels < [camera.width - 2, camera.height - 2]).all(axis=1)
    )
    assert inside.mean() > 0.5
    seen = cv2.remap(image, (pixels[inside] - 0.5).astype(np.float32)[:, None], None, cv2.INTER_LINEAR)[:, 0] / 255
    return float(np.median(np.abs(seen - cloud.colours[inside]).mean(axis=1)))


def test_flame_steak_distorted_model(real_data: Path) -> None:
    """The OPENCV model of the same rig has the same poses, up to what undistorting leaves alone."""
    folder = real_data / "flame_steak_frame0"
    straight, bent = read_model(folder / "sparse" / "0"), read_model(folder / "distorted" / "sparse" / "0")
    assert {camera.model for camera in bent.cameras.values()} == {"OPENCV"}
    poses = {image.name: image.world_to_camera for image in straight.images}
    for image in bent.images:
        np.testing.assert_allclose(image.world_to_camera, poses[image.name], atol=1e-9)
        assert bent.camera_of(image, "a").has_distortion


def test_coefficients_that_are_not_supported_are_named(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "sparse", [("a.png", rig(["a"])[0], "FULL_OPENCV")], POINTS)
    write_picture(tmp_path / "images" / "a.png", picture(0, 0))
    path = tmp_path / "sparse" / "cameras.txt"
    path.write_text(path.read_text().rstrip() + "\n")
    path.write_text(path.read_text().replace(" 0.0\n", " 0.1\n"))
    with pytest.raises(InputError, match="FULL_OPENCV: has k4, k5 or k6, which are not supported"):
        open_dataset(tmp_path)


@both_formats
def test_pictures_of_several_sizes_are_scaled_to_the_smallest(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, write: Writer
) -> None:
    """Of two kinds of cameras, and of one whose pictures were made smaller afterwards."""
    cameras = list(_one_instant(tmp_path, write))
    cameras[1] = cameras[1].scaled(192, 128)
    write(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in cameras], POINTS)
    write_picture(tmp_path / "images" / "cam02.png", picture(1, 0, (192, 128)))
    write_picture(tmp_path / "images" / "cam10.png", picture(2, 0, (48, 32)))
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert "several sizes; all are scaled to 48x32" in caplog.text
    for found, wanted in zip(dataset.cameras, rig(NAMES), strict=True):
        assert (found.width, found.height) == (48, 32)
        np.testing.assert_allclose(found.intrinsics[:2], wanted.intrinsics[:2] / 2)
    (frame,) = dataset.frames()
    assert [read_back(image) for image in frame.images] == [(0, 0), (1, 0), (2, 0)]
    assert open_dataset(tmp_path, cameras=["cam00", "cam02"]).cameras[0].width == 96


def test_a_model_without_points_has_none(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "sparse" / "0" / "points3D.bin").unlink()
    assert open_dataset(tmp_path).points() is None


def test_spaces_in_names_are_kept(tmp_path: Path) -> None:
    names = ["left  cam.png", "right cam 2.png"]
    write_colmap_text(tmp_path / "sparse", [(n, c, "PINHOLE") for n, c in zip(names, rig("ab"), strict=True)], POINTS)
    for index, name in enumerate(names):
        write_picture(tmp_path / "images" / name, picture(index, 0))
    assert open_dataset(tmp_path).names == ("left  cam", "right cam 2")


@pytest.mark.parametrize("names", [NAMES, ("0000", "0001", "0002")], ids=["words", "numbers"])
def test_text_models_without_lines_of_observations(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Programs that know no observations leave out the line, empty or not, that follows each image."""
    write_colmap_text(tmp_path / "sparse", [(camera.name, camera, "PINHOLE") for camera in rig(names)], POINTS)
    path = tmp_path / "sparse" / "images.txt"
    path.write_text("\n".join(line for line in path.read_text().splitlines() if len(line.split()) == 10))
    for index, name in enumerate(names):
        write_picture(tmp_path / "images" / f"{name}.png", picture(index, 0))
    assert open_dataset(tmp_path).names == names


def test_cameras_may_share_a_lens(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_text)
    lenses, images = (tmp_path / "sparse" / "0" / f"{stem}.txt" for stem in ("cameras", "images"))
    lenses.write_text("\n".join(lenses.read_text().splitlines()[:2]))
    images.write_text("\n".join(re.sub(r" \d+ (cam\d+)", r" 1 \1", line) for line in images.read_text().splitlines()))
    dataset = open_dataset(tmp_path)
    assert dataset.names == NAMES
    assert len({camera.intrinsics[0, 0] for camera in dataset.cameras}) == 1


def test_a_model_where_nerfstudio_puts_it(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "colmap").mkdir()
    (tmp_path / "sparse").rename(tmp_path / "colmap" / "sparse")
    (tmp_path / "images_2").mkdir()
    assert open_dataset(tmp_path).names == NAMES


def test_pictures_of_other_kinds_are_named(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    for file in (tmp_path / "images").iterdir():
        file.rename(file.with_suffix(".HEIC"))
    with pytest.raises(InputError, match=r"holds none .* \(only PNG and JPEG are read; convert cam00\.HEIC, "):
        open_dataset(tmp_path)


@both_formats
def test_of_several_models_the_largest_counts(tmp_path: Path, write: Writer, caplog: pytest.LogCaptureFixture) -> None:
    _one_instant(tmp_path, write)
    (tmp_path / "sparse" / "0").rename(tmp_path / "sparse" / "1")
    write(tmp_path / "sparse" / "0", [("cam10.png", rig(NAMES)[0], "PINHOLE")], POINTS)
    write(tmp_path / "sparse" / "2", [], POINTS)
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert dataset.names == NAMES
    np.testing.assert_allclose(dataset.cameras[2].world_to_camera, rig(NAMES)[2].world_to_camera, atol=1e-12)
    assert "holds 3 models, and 1 is used, which has most pictures (0: 1, 1: 3, 2: 0)" in caplog.text


def test_one_file_never_serves_several_cameras(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Folders of cameras that were copied into one leave a single 0000.png."""
    cameras = rig(NAMES)
    entries = [(f"{camera.name}/0000.png", camera, "PINHOLE") for camera in cameras]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    write_picture(tmp_path / "images" / "0000.png", picture(0, 0))
    with pytest.raises(InputError, match=r"holds none of the pictures .*: cam00/0000\.png, cam02/0000\.png"):
        open_dataset(tmp_path)
    write_picture(tmp_path / "images" / "cam02" / "0000.JPG", picture(1, 0))  # found in its folder, converted
    write_picture(tmp_path / "images" / "cam10" / "0000.png", picture(2, 0))
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert dataset.names == ("cam00/0000", "cam02/0000", "cam10/0000")
    (frame,) = dataset.frames()
    assert [read_back(image) for image in frame.images] == [(0, 0), (1, 0), (2, 0)]


def test_pictures_that_the_model_does_not_place_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    write_picture(tmp_path / "images" / "cam11.png", picture(3, 0))
    (tmp_path / "images" / "._cam00.png").write_bytes(b"of macOS")
    with caplog.at_level(logging.WARNING):
        assert open_dataset(tmp_path).names == NAMES
    assert "1 pictures are left out, as the model does not place them: cam11.png" in caplog.text


def test_a_folder_of_pictures_a_camera_is_told_where_later_instants_belong(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    entries = [(f"{camera.name}/0000.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write_colmap_binary(tmp_path / "sparse" / "0", entries, POINTS)
    for number, name in enumerate(NAMES):
        for instant in range(2):
            write_picture(tmp_path / "images" / name / f"{instant:04d}.png", picture(number, instant))
    with caplog.at_level(logging.WARNING):
        open_dataset(tmp_path)
    assert "put those of each instant into a folder frames/0000" in caplog.text
    caplog.clear()
    for instant in range(2):
        (tmp_path / "frames" / f"{instant:04d}").mkdir(parents=True)
        for number, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / f"{instant:04d}" / name / "0000.png", picture(number, instant))
    with caplog.at_level(logging.WARNING):
        frames = list(open_dataset(tmp_path).frames())
    assert [[read_back(image) for image in frame.images] for frame in frames] == [
        [(number, instant) for number in range(len(NAMES))] for instant in range(2)
    ]
    assert "each camera has a folder" not in caplog.text


@both_formats
def test_names_that_are_not_utf8_lead_to_their_files(tmp_path: Path, write: Writer) -> None:
    _one_instant(tmp_path, write)
    kind = "bin" if write is write_colmap_binary else "txt"
    model = tmp_path / "sparse" / "0" / f"images.{kind}"
    model.write_bytes(model.read_bytes().replace(b"cam02.png", b"c\xfcm2.png"))
    (tmp_path / "images" / "cam02.png").rename(tmp_path / "images" / os.fsdecode(b"c\xfcm2.png"))
    dataset = open_dataset(tmp_path)
    assert sorted(dataset.names) == ["cam00", "cam10", "c\ufffdm2"]
    (frame,) = dataset.frames()
    assert {name: read_back(image)[0] for name, image in zip(dataset.names, frame.images, strict=True)} == {
        "cam00": 0,
        "cam10": 2,
        "c\ufffdm2": 1,
    }


def test_a_missing_picture_whose_name_is_not_utf8_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    _one_instant(tmp_path, write_colmap_binary)
    model = tmp_path / "sparse" / "0" / "images.bin"
    model.write_bytes(model.read_bytes().replace(b"cam02.png", b"c\xfcm2.png"))
    with caplog.at_level(logging.WARNING):
        assert open_dataset(tmp_path).names == ("cam00", "cam10")
    assert "names that are not UTF-8" in caplog.text


@both_formats
def test_backslashes_of_windows_are_slashes(tmp_path: Path, write: Writer) -> None:
    entries = [(rf"left\{camera.name}.png", camera, "PINHOLE") for camera in rig(NAMES)]
    write(tmp_path / "sparse" / "0", entries, POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "images" / "left" / f"{name}.png", picture(index, 0))
    dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (NAMES, ())


def test_text_models_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_text)
    for file in (tmp_path / "sparse" / "0").iterdir():
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    dataset = open_dataset(tmp_path)
    points = dataset.points()
    assert dataset.names == NAMES
    assert points is not None
    assert len(points) == 2


def test_text_models_in_utf_16_say_so(tmp_path: Path) -> None:
    _one_instant(tmp_path, write_colmap_text)
    cameras = tmp_path / "sparse" / "0" / "cameras.txt"
    cameras.write_text(cameras.read_text(), "utf-16")
    with pytest.raises(InputError, match=r"cameras\.txt: is UTF-16 text; save it as UTF-8"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("stray", ["__MACOSX", "thumbs", "0001_old", ".trash"])
def test_stray_folders_are_no_instants(tmp_path: Path, stray: str) -> None:
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for folder in ("0000", "0001", "0002", stray):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / "frames" / folder / f"{name}.png", picture(index, 0))
    assert open_dataset(tmp_path).frame_count == 3


def test_many_stray_folders_beside_few_instants_are_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As network drives and other systems leave behind."""
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "frames" / "0000" / f"{name}.png", picture(index, 0))
    for folder in ("@eaDir", "$RECYCLE.BIN", "lost+found"):
        (tmp_path / "frames" / folder).mkdir()
    assert [frame.present.all() for frame in open_dataset(tmp_path).frames()] == [True]
    assert "@eaDir" in caplog.text


def test_stray_folders_beside_instants_with_models_are_no_instants(tmp_path: Path) -> None:
    for t in range(3):
        for index, name in enumerate(NAMES):
            write_picture(tmp_path / f"t{t}" / "images" / f"{name}.png", picture(index, t))
    write_colmap_text(tmp_path / "t0" / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], POINTS)
    (tmp_path / "video").mkdir()
    (tmp_path / "__MACOSX").mkdir()
    dataset = open_dataset(tmp_path)
    assert [read_back(frame.images[2]) for frame in dataset.frames()] == [(2, 0), (2, 1), (2, 2)]


def test_long_names_are_cut_to_what_a_stream_can_hold(tmp_path: Path) -> None:
    cameras = rig(["摄像机机位" * 5 + str(index) for index in range(3)])
    write_colmap_binary(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in cameras], POINTS)
    for index, camera in enumerate(cameras):
        write_picture(tmp_path / "images" / f"{camera.name}.png", picture(index, 0))
    names = open_dataset(tmp_path).names
    assert [name[-1] for name in names] == ["0", "1", "2"]
    assert all(len(name.encode()) <= 64 and "\ufffd" not in name for name in names)
