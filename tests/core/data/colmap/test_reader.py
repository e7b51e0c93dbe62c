"""COLMAP folders of one instant: cameras and points fit the pictures that are there."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from streamlod.core.frames import PointCloud
from tests.core.data.colmap.folders import NAMES, POINTS, Writer, both_formats, one_instant
from tests.core.data.writers import picture, read_back, rig, write_colmap_binary, write_picture


@both_formats
def test_one_instant(tmp_path: Path, write: Writer) -> None:
    cameras = one_instant(tmp_path, write)
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


def test_reduced_pictures_scale_the_calibration(tmp_path: Path) -> None:
    large = rig(NAMES, (192, 128))
    write_colmap_binary(tmp_path / "sparse", [(f"{c.name}.png", c, "PINHOLE") for c in large], POINTS)
    for index, name in enumerate(NAMES):
        write_picture(tmp_path / "images_2" / f"{name}.png", picture(index, 0))
    dataset = open_dataset(tmp_path)
    np.testing.assert_allclose(dataset.cameras[0].intrinsics[:2], large[0].intrinsics[:2] / 2)


@both_formats
def test_pictures_of_several_sizes_are_scaled_to_the_smallest(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, write: Writer
) -> None:
    """Of two kinds of cameras, and of one whose pictures were made smaller afterwards."""
    cameras = list(one_instant(tmp_path, write))
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


def test_missing_pictures_are_skipped_counted_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "images" / "cam02.png").unlink()
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert (dataset.names, dataset.skipped) == (("cam00", "cam10"), ("cam02.png",))
    assert "1 pictures of the model are missing: cam02.png" in caplog.text


def test_pictures_that_the_model_does_not_place_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    one_instant(tmp_path, write_colmap_binary)
    write_picture(tmp_path / "images" / "cam11.png", picture(3, 0))
    (tmp_path / "images" / "._cam00.png").write_bytes(b"of macOS")
    with caplog.at_level(logging.WARNING):
        assert open_dataset(tmp_path).names == NAMES
    assert "1 pictures are left out, as the model does not place them: cam11.png" in caplog.text


def test_pictures_of_other_kinds_are_named(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_binary)
    for file in (tmp_path / "images").iterdir():
        file.rename(file.with_suffix(".HEIC"))
    with pytest.raises(InputError, match=r"holds none .* \(only PNG and JPEG are read; convert cam00\.HEIC, "):
        open_dataset(tmp_path)


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
