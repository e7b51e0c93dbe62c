"""The N3DV and Meet Room layouts, on clips written here."""

from __future__ import annotations

import json
import sys
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.data.dataset import Dataset
from streamlod.core.data.video_folder import llff_pose
from streamlod.core.errors import InputError
from tests.core.data.writers import (
    llff_rows,
    read_back,
    rig,
    write_colmap_text,
    write_video_clip,
)

GAPS = ("cam00", "cam02", "cam05", "cam11")


@pytest.fixture(scope="module")
def n3dv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("n3dv")
    write_video_clip(folder, GAPS, frames=8)
    return folder


def _assert_same_cameras(dataset: Dataset, names: tuple[str, ...], size: tuple[int, int] = (96, 64)) -> None:
    assert dataset.names == names
    for found, wanted in zip(dataset.cameras, rig(names, size), strict=True):
        np.testing.assert_allclose(found.intrinsics, wanted.intrinsics, atol=1e-9)
        np.testing.assert_allclose(found.world_to_camera, wanted.world_to_camera, atol=1e-9)
        assert (found.width, found.height) == size


def test_n3dv_cameras_keep_names_focal_lengths_and_poses_across_gaps(n3dv: Path) -> None:
    dataset = open_dataset(n3dv)
    assert (dataset.layout, dataset.fps, dataset.frame_count) == ("n3dv", 30, 8)
    assert dataset.depth_bounds == (1, 9)
    assert dataset.points() is None
    _assert_same_cameras(dataset, GAPS)


def test_names_in_capitals_count_by_their_numbers(tmp_path: Path) -> None:
    write_video_clip(tmp_path, GAPS, frames=2)
    for name, called in (("cam02", "CAM02.MP4"), ("cam05", "Cam05.mp4")):
        (tmp_path / f"{name}.mp4").rename(tmp_path / called)
    dataset = open_dataset(tmp_path)
    assert dataset.names == ("cam00", "CAM02", "Cam05", "cam11")
    assert [read_back(image)[0] for image in next(dataset.frames()).images] == [0, 1, 2, 3]


def test_frames_hold_every_camera_at_its_instant(n3dv: Path) -> None:
    for index, frame in enumerate(open_dataset(n3dv).frames()):
        assert frame.index == index
        assert frame.time_ns == round(index * 1e9 / 30)
        assert frame.present.all()
        assert [read_back(image) for image in frame.images] == [(camera, index) for camera in range(4)]
    assert index == 7


def test_a_range_of_frames_and_a_choice_of_cameras(n3dv: Path) -> None:
    dataset = open_dataset(n3dv, cameras=["cam05", "cam00"])
    assert dataset.names == ("cam05", "cam00")
    frames = list(dataset.frames(3, 5))
    assert [frame.index for frame in frames] == [3, 4]
    assert [[read_back(image) for image in frame.images] for frame in frames] == [[(2, 3), (0, 3)], [(2, 4), (0, 4)]]
    assert [read_back(image) for image in next(open_dataset(n3dv).select(["cam11"]).frames(7)).images] == [(3, 7)]
    with pytest.raises(ValueError, match="frames 3 to 9"):
        dataset.frames(3, 9)


def test_pictures_are_averaged_by_area_and_cameras_follow(n3dv: Path) -> None:
    whole, half = open_dataset(n3dv), open_dataset(n3dv, downscale=2)
    camera = half.cameras[1]
    assert (camera.width, camera.height) == (48, 32)
    np.testing.assert_allclose(camera.intrinsics[:2], whole.cameras[1].intrinsics[:2] / 2)
    large, small = next(whole.frames()).images, next(half.frames()).images
    mean = large.reshape(4, 32, 2, 48, 2, 3).mean(axis=(2, 4))
    assert np.abs(small - mean).max() <= 0.5


def test_frames_are_not_kept_in_memory(tmp_path: Path) -> None:
    size, frames = (320, 240), 24
    write_video_clip(tmp_path, ("cam00", "cam01"), frames, size)
    one = 2 * size[0] * size[1] * 3
    dataset = open_dataset(tmp_path)
    tracemalloc.start()
    try:
        for _ in dataset.frames():
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 5 * one < frames * one


def test_dropping_the_iterator_early_closes_the_files(n3dv: Path) -> None:
    def open_files() -> list[Path]:
        found = list[Path]()
        for link in Path("/proc/self/fd").glob("*"):
            with suppress(OSError):  # closed since, by another thread
                found.append(link.readlink())
        return [file for file in found if file.is_relative_to(n3dv)]

    frames = open_dataset(n3dv).frames()
    next(frames)
    assert open_files() or sys.platform != "linux"
    frames.close()  # type: ignore[attr-defined]
    assert not open_files()


def test_meet_room_videos_sort_as_numbers(tmp_path: Path) -> None:
    names = tuple(f"cam_{number}" for number in range(13))
    write_video_clip(tmp_path, names, frames=2)
    dataset = open_dataset(tmp_path)
    assert dataset.layout == "meetroom"
    _assert_same_cameras(dataset, names)
    assert [read_back(image)[0] for image in next(dataset.frames()).images] == list(range(13))


def test_llff_axes_by_hand() -> None:
    # columns down, right, backwards: stands at z = 5 and looks along -z with +y up
    matrix = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 5]], np.float64)
    pose = llff_pose(matrix)
    np.testing.assert_allclose(pose @ [0, 0, 0, 1], [0, 0, 5, 1])
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [1, 0, 5, 1])
    np.testing.assert_allclose(pose @ [0, 1, 0, 1], [0, -1, 5, 1])  # up in the world is up in the picture


def test_distortion_file_is_honoured(tmp_path: Path) -> None:
    write_video_clip(tmp_path, ("cam_0", "cam_1"), frames=1)
    (tmp_path / "distortion.json").write_text('{"k1": 0.084, "p2": -0.001}')
    shared = open_dataset(tmp_path)
    assert [c.distortion.tolist() for c in shared.recording.cameras] == [[0.084, 0, 0, -0.001, 0]] * 2
    assert not any(camera.has_distortion for camera in shared.cameras)
    (tmp_path / "distortion.json").write_text('{"cam_0": {"k1": 0.1}, "cam_1": {}}')
    assert open_dataset(tmp_path).recording.cameras[0].distortion[0] == 0.1
    (tmp_path / "distortion.json").write_text('{"cam_0": {"k1": 0.1}}')
    with pytest.raises(InputError, match=r"distortion\.json: has no coefficients of cam_1"):
        open_dataset(tmp_path)
    (tmp_path / "distortion.json").write_text('{"k9": 0.1}')
    with pytest.raises(InputError, match="k9 is no coefficient"):
        open_dataset(tmp_path)


def test_shared_intrinsics_file(tmp_path: Path) -> None:
    write_video_clip(tmp_path, ("cam_0", "cam_1"), frames=1)
    rows = llff_rows(rig(("cam_0", "cam_1")))
    matrices = rows[:, :15].reshape(-1, 3, 5)[:, :, :4].reshape(-1, 12)
    np.save(tmp_path / "poses_bounds.npy", np.concatenate([matrices, rows[:, 15:]], axis=1))
    np.save(tmp_path / "hwf_cxcy.npy", np.array([128, 192, 170, 172, 90, 66.0]))  # of pictures twice as large
    for camera in open_dataset(tmp_path).cameras:
        np.testing.assert_allclose(camera.intrinsics, [[85, 0, 45], [0, 86, 33], [0, 0, 1]])


def test_a_colmap_model_may_replace_poses_bounds(tmp_path: Path) -> None:
    names = ("cam_0", "cam_1")
    write_video_clip(tmp_path, names, frames=1)
    (tmp_path / "poses_bounds.npy").unlink()
    with pytest.raises(InputError, match=r"poses_bounds\.npy: is missing"):
        open_dataset(tmp_path)
    points = np.array([[0.1, 0.2, 0.3, 255, 0, 51]])
    write_colmap_text(tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "OPENCV") for c in rig(names)], points)
    dataset = open_dataset(tmp_path)
    assert dataset.layout == "meetroom"
    _assert_same_cameras(dataset, names)
    cloud = dataset.points()
    assert cloud is not None
    np.testing.assert_allclose(cloud.colours, [[1, 0, 0.2]], atol=1e-6)


def test_distortion_json_needs_numbers(tmp_path: Path) -> None:
    write_video_clip(tmp_path, ("cam_0",), frames=1)
    (tmp_path / "distortion.json").write_text(json.dumps({"k1": "much"}))
    with pytest.raises(InputError, match="k1 must be a number"):
        open_dataset(tmp_path)
