"""COLMAP models in both formats: cameras, poses and points, and which of several models counts."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.data.colmap.model import read_model, read_points
from streamlod.core.errors import InputError
from tests.core.data.colmap.folders import NAMES, POINTS, Writer, both_formats, one_instant
from tests.core.data.writers import COLMAP_MODELS, picture, rig, write_colmap_binary, write_colmap_text, write_picture


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


def test_coefficients_that_are_not_supported_are_named(tmp_path: Path) -> None:
    write_colmap_text(tmp_path / "sparse", [("a.png", rig(["a"])[0], "FULL_OPENCV")], POINTS)
    write_picture(tmp_path / "images" / "a.png", picture(0, 0))
    path = tmp_path / "sparse" / "cameras.txt"
    path.write_text(path.read_text().rstrip() + "\n")
    path.write_text(path.read_text().replace(" 0.0\n", " 0.1\n"))
    with pytest.raises(InputError, match="FULL_OPENCV: has k4, k5 or k6, which are not supported"):
        open_dataset(tmp_path)


def test_cameras_may_share_a_lens(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_text)
    lenses, images = (tmp_path / "sparse" / "0" / f"{stem}.txt" for stem in ("cameras", "images"))
    lenses.write_text("\n".join(lenses.read_text().splitlines()[:2]))
    images.write_text("\n".join(re.sub(r" \d+ (cam\d+)", r" 1 \1", line) for line in images.read_text().splitlines()))
    dataset = open_dataset(tmp_path)
    assert dataset.names == NAMES
    assert len({camera.intrinsics[0, 0] for camera in dataset.cameras}) == 1


@both_formats
def test_a_picture_that_a_model_places_twice_is_refused(tmp_path: Path, write: Writer) -> None:
    one_instant(tmp_path, write)
    write(tmp_path / "sparse" / "0", [("cam00.png", camera, "PINHOLE") for camera in rig(NAMES)], POINTS)
    with pytest.raises(InputError, match=r"sparse/0: places pictures twice: cam00\.png$"):
        open_dataset(tmp_path)


def test_points_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    write_colmap_binary(tmp_path, [], np.concatenate([POINTS, [[np.nan, 0, 0, 0, 0, 0], [1e300, 0, 0, 0, 0, 0]]]))
    assert len(read_points(tmp_path)) == 2
    write_colmap_binary(tmp_path, [], POINTS[:0])
    assert len(read_points(tmp_path)) == 0


def test_a_model_without_points_has_none(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "sparse" / "0" / "points3D.bin").unlink()
    assert open_dataset(tmp_path).points() is None


@both_formats
def test_of_several_models_the_largest_counts(tmp_path: Path, write: Writer, caplog: pytest.LogCaptureFixture) -> None:
    one_instant(tmp_path, write)
    (tmp_path / "sparse" / "0").rename(tmp_path / "sparse" / "1")
    write(tmp_path / "sparse" / "0", [("cam10.png", rig(NAMES)[0], "PINHOLE")], POINTS)
    write(tmp_path / "sparse" / "2", [], POINTS)
    with caplog.at_level(logging.WARNING):
        dataset = open_dataset(tmp_path)
    assert dataset.names == NAMES
    np.testing.assert_allclose(dataset.cameras[2].world_to_camera, rig(NAMES)[2].world_to_camera, atol=1e-12)
    assert "holds 3 models, and 1 is used, which has most pictures (0: 1, 1: 3, 2: 0)" in caplog.text


def test_a_model_where_nerfstudio_puts_it(tmp_path: Path) -> None:
    one_instant(tmp_path, write_colmap_binary)
    (tmp_path / "colmap").mkdir()
    (tmp_path / "sparse").rename(tmp_path / "colmap" / "sparse")
    (tmp_path / "images_2").mkdir()
    assert open_dataset(tmp_path).names == NAMES


def test_flame_steak_distorted_model(real_data: Path) -> None:
    """The OPENCV model of the same rig has the same poses, up to what undistorting leaves alone."""
    folder = real_data / "flame_steak_frame0"
    straight, bent = read_model(folder / "sparse" / "0"), read_model(folder / "distorted" / "sparse" / "0")
    assert {camera.model for camera in bent.cameras.values()} == {"OPENCV"}
    poses = {image.name: image.world_to_camera for image in straight.images}
    for image in bent.images:
        np.testing.assert_allclose(image.world_to_camera, poses[image.name], atol=1e-9)
        assert bent.camera_of(image, "a").has_distortion
