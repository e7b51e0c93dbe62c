"""The synthetic clip as a data set and as files that the N3DV reader reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data import open_dataset
from streamlod.core.errors import InputError
from streamlod.core.metrics import psnr
from streamlod.core.synthetic import (
    SyntheticSpec,
    cameras,
    ground_truth,
    open_synthetic,
    read_spec,
    render_image,
    write_clip,
)

SPEC = SyntheticSpec(cameras=3, frames=5, width=192, height=108, fps=25.0)
SMALL = SyntheticSpec(cameras=2, frames=2, width=32, height=18, seed=5)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synthetic") / "clip"
    write_clip(SPEC, folder)
    return folder


def test_the_data_set_in_memory_renders_what_is_read() -> None:
    data = open_synthetic(SPEC).select(["cam02", "cam00"])
    frames = list(data.frames(2, 4))
    assert [frame.index for frame in frames] == [2, 3]
    assert frames[0].time_ns == 80_000_000
    assert np.array_equal(frames[1].images[0], render_image(SPEC, 3, 2))
    assert (data.fps, data.frame_count, data.points()) == (25.0, 5, None)


def test_depth_bounds_hold_what_the_cameras_see() -> None:
    bounds = open_synthetic(SPEC).depth_bounds
    assert bounds is not None
    for camera in range(SPEC.cameras):
        depth = ground_truth(SPEC, 4, camera).depth
        assert bounds[0] < depth.min() < depth.max() < bounds[1]


@pytest.mark.long
def test_the_files_read_back_as_the_clip(clip: Path) -> None:
    data = open_dataset(clip)
    assert (data.layout, data.frame_count, data.fps) == ("n3dv", 5, 25.0)
    for camera, exact in zip(data.cameras, cameras(SPEC), strict=True):
        assert camera.name == exact.name
        assert np.allclose(camera.world_to_camera, exact.world_to_camera, atol=1e-12)
        assert np.allclose(camera.intrinsics, exact.intrinsics)
    for frame, truth in zip(data.frames(), open_synthetic(SPEC).frames(), strict=True):
        luma = (frame.images.astype(float) - truth.images) @ [0.299, 0.587, 0.114]
        assert 10 * np.log10(255**2 / np.mean(luma**2)) > 36
        for number in range(SPEC.cameras):
            assert psnr(frame.images[number], truth.images[number]) > 34


@pytest.mark.long
def test_the_truth_beside_the_videos_is_the_truth(clip: Path) -> None:
    with np.load(clip / "ground_truth" / "frame00004.npz", allow_pickle=False) as truth:
        exact = ground_truth(SPEC, 4, 1)
        assert np.allclose(truth["depth"][1], exact.depth, rtol=1e-3)
        assert np.array_equal(truth["moving"][1], exact.moving)
        assert np.array_equal(truth["mirror"][1], exact.mirror)
    description = json.loads((clip / "ground_truth" / "spec.json").read_text())
    assert SyntheticSpec(**description["spec"]) == SPEC
    assert np.allclose(description["cameras"][2]["world_to_camera"], cameras(SPEC)[2].world_to_camera)


def test_a_folder_in_use_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "note").write_text("keep")
    with pytest.raises(InputError, match="not an empty folder"):
        write_clip(SPEC, tmp_path / "mine")
    assert (tmp_path / "mine" / "note").read_text() == "keep"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_an_interrupted_clip_leaves_nothing_behind(tmp_path: Path) -> None:
    def stop(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_clip(SyntheticSpec(cameras=2, frames=2, width=64, height=36), tmp_path / "clip", stop)
    assert list(tmp_path.iterdir()) == []


def test_odd_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="even"):
        write_clip(SyntheticSpec(width=161, height=90), tmp_path / "clip")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("synthetic") / "small"
    told: list[float] = []
    write_clip(SMALL, folder, told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    return folder


def test_the_description_of_a_clip_is_read_back(small: Path, tmp_path: Path) -> None:
    assert read_spec(small) == SMALL
    assert read_spec(tmp_path) is None


@pytest.mark.parametrize(
    "text", ["[]", "{}", '{"spec": {"cameras": 3}}', '{"spec": 5}', "{", '{"spec": {"cameras": "many", "rest": 0}}']
)
def test_a_damaged_description_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "ground_truth").mkdir()
    (tmp_path / "ground_truth" / "spec.json").write_text(text)
    with pytest.raises(InputError):
        read_spec(tmp_path)


def test_a_description_with_a_value_of_another_type_is_refused(small: Path, tmp_path: Path) -> None:
    value = json.loads((small / "ground_truth" / "spec.json").read_text())
    value["spec"]["frames"] = "10"
    (tmp_path / "ground_truth").mkdir()
    (tmp_path / "ground_truth" / "spec.json").write_text(json.dumps(value))
    with pytest.raises(InputError):
        read_spec(tmp_path)


def test_a_description_of_an_earlier_version_means_the_room(small: Path, tmp_path: Path) -> None:
    value = json.loads((small / "ground_truth" / "spec.json").read_text())
    del value["spec"]["kind"], value["spec"]["speed"]
    (tmp_path / "ground_truth").mkdir()
    (tmp_path / "ground_truth" / "spec.json").write_text(json.dumps(value))
    assert read_spec(tmp_path) == SMALL
