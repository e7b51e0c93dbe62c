"""The report, on a clip whose truth is known: what the decoded file itself shows."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.client.commands import evaluate, export
from streamlod.client.evaluation.file_scores import evaluate_file
from streamlod.client.evaluation.measure import scores
from streamlod.client.evaluation.report.output import side_by_side
from streamlod.core.arrays import UInt8
from streamlod.core.camera import Camera
from streamlod.core.errors import InputError
from streamlod.core.render.splatter import Splatter, draw_cloud
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.gaussians import GaussianCloud
from tests.client.clips import plain_scene, states, write_clip
from tests.core.data.writers import llff_rows, write_colmap_binary, write_picture, write_video

FRAMES = 4


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[Scene], list[bytes]]:
    """A file, and a data set of twice the size that shows exactly what the file does."""
    folder = tmp_path_factory.mktemp("clip")
    scene = plain_scene()
    small = tuple(camera.scaled(80, 48) for camera in scene.header.cameras)
    scenes = states(FRAMES, replace(scene, header=replace(scene.header, cameras=small)))
    packets = write_clip(folder / "a.slod", scenes)
    large = [camera.scaled(160, 96) for camera in small]
    data = folder / "data"
    data.mkdir()
    np.save(data / "poses_bounds.npy", llff_rows(large))
    for camera in large:
        splatter = Splatter()
        write_video(data / f"{camera.name}.mp4", [splatter.picture(state, camera) for state in scenes])
    return folder / "a.slod", data, scenes, packets


def test_report_holds_the_contract(clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path) -> None:
    scene, data, _, packets = clip
    scene.with_name("a.slod.json").write_text(json.dumps({"train_seconds": 1.5, "first_frame_seconds": 30}))
    text = evaluate(scene, data, ("cam01",), tmp_path / "new" / "report.json", tmp_path / "images")
    report = json.loads((tmp_path / "new" / "report.json").read_text())
    assert [frame["frame"] for frame in report["per_frame"]] == list(range(FRAMES))
    assert [frame["bytes"] for frame in report["per_frame"]] == [len(packet) for packet in packets]
    assert set(report["per_frame"][0]) >= {"frame", "psnr", "ssim", "lpips", "bytes"}
    mean = report["mean"]
    assert mean["keyframe_kilobytes"] == len(packets[0]) / 1000
    assert mean["predicted_kilobytes"] == pytest.approx(np.mean([len(packet) for packet in packets[1:]]) / 1000)
    assert (mean["train_seconds"], mean["first_frame_seconds"]) == (1.5, 30)
    assert mean["render_fps"] > 0
    assert mean["psnr"] > 25  # half size, video compression
    assert mean["psnr_fitted"] >= mean["psnr"]
    assert mean["ssim"] > 0.8
    assert f"PSNR                      {mean['psnr']:.2f} dB" in text
    assert "PSNR by frame" in (tmp_path / "new" / "report.svg").read_text()
    names = sorted(path.name for path in (tmp_path / "images").iterdir())
    assert names == [f"cam01_{index:05d}.png" for index in range(FRAMES)]
    assert cv2.imread(str(tmp_path / "images" / names[0])).shape == (48, 3 * 80, 3)


def test_the_calibration_may_have_another_unit_and_origin_than_the_file(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path
) -> None:
    scene, data, _, _ = clip
    shutil.copytree(data, tmp_path / "data")
    table = np.load(data / "poses_bounds.npy")
    poses = table[:, :15].reshape(-1, 3, 5)
    poses[:, :, 3] = 1000 * poses[:, :, 3] + [4e6, -1e6, 3e6]
    np.save(tmp_path / "data" / "poses_bounds.npy", np.hstack([poses.reshape(-1, 15), 1000 * table[:, 15:]]))
    usual, moved = (evaluate_file(scene, folder, ("cam01",)) for folder in (data, tmp_path / "data"))
    assert moved["mean"]["psnr"] == pytest.approx(usual["mean"]["psnr"], abs=0.01)


def test_a_rig_that_holds_out_no_camera_is_measured_at_its_own(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path
) -> None:
    scene, data, scenes, _ = clip
    names = tuple(camera.name for camera in scenes[0].header.cameras)
    whole, named = evaluate_file(scene, data, ()), evaluate_file(scene, data, names)
    assert whole["cameras"] == list(names)
    assert whole["mean"]["psnr"] == named["mean"]["psnr"]
    assert "means over the cameras that trained" in evaluate(scene, data, ())
    assert "means over the held-out cameras" in evaluate(scene, data, names)
    shutil.copytree(data, tmp_path / "data")
    for number, name in enumerate(names):
        (tmp_path / "data" / f"{name}.mp4").rename(tmp_path / "data" / f"cam{70 + number}.mp4")
    with pytest.raises(InputError, match="has none of the cameras that trained"):
        evaluate_file(scene, tmp_path / "data", ())


def test_what_was_drawn_to_be_measured_is_not_drawn_again_for_its_place(
    clip: tuple[Path, Path, list[Scene], list[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, data, scenes, _ = clip
    names = tuple(camera.name for camera in scenes[0].header.cameras)
    drawings, counts = 0, list[int]()

    def counting(cloud: GaussianCloud, camera: Camera, *further: Any) -> UInt8:
        nonlocal drawings
        drawings += 1
        return draw_cloud(cloud, camera, *further)

    monkeypatch.setattr(scores, "draw_cloud", counting)
    for test in (names, ()):
        drawings = 0
        evaluate_file(scene, data, test)
        counts.append(drawings)
    assert counts[0] == counts[1] > 0


def test_cameras_that_trained_and_those_that_did_not_are_told_apart(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path
) -> None:
    """The file's header names the whole rig; which of it trained stand in the figures beside it."""
    _, data, scenes, _ = clip
    first, second = (camera.name for camera in scenes[0].header.cameras[:2])
    write_clip(tmp_path / "a.slod", scenes)
    figures = tmp_path / "a.slod.json"
    figures.write_text(json.dumps({"trained_cameras": [second]}))
    assert evaluate_file(tmp_path / "a.slod", data, ())["cameras"] == [second]
    held_out = evaluate_file(tmp_path / "a.slod", data, (first,))
    assert (held_out["cameras"], list(held_out["places"]["at"])) == ([first], [second])
    with pytest.raises(InputError, match=f"--test: {second} trained .*; hold it out by train --test"):
        evaluate_file(tmp_path / "a.slod", data, (first, second))
    figures.write_text(json.dumps({"trained_cameras": "all"}))
    with pytest.raises(InputError, match="must be a list of camera names"):
        evaluate_file(tmp_path / "a.slod", data, ())


def test_another_scene_scores_worse(clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path) -> None:
    scene, data, scenes, _ = clip
    other = states(FRAMES, replace(plain_scene(seed=9), header=scenes[0].header))
    write_clip(tmp_path / "other.slod", other)
    right = evaluate_file(scene, data, ("cam00", "cam01"))
    wrong = evaluate_file(tmp_path / "other.slod", data, ("cam00", "cam01"))
    for mine, theirs in zip(right["per_frame"], wrong["per_frame"], strict=True):
        assert theirs["psnr"] < mine["psnr"] - 3
    assert wrong["mean"]["train_seconds"] is None


def test_pictures_are_measured_at_the_size_of_the_training_or_as_asked(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path
) -> None:
    scene, data, _, _ = clip
    widths, psnr = [], []
    for downscale in (None, 1.0, 2.0):
        folder = tmp_path / str(downscale)
        report = evaluate_file(scene, data, ("cam01",), folder, downscale=downscale)
        widths.append(cv2.imread(str(folder / "cam01_00000.png")).shape[1])
        psnr.append(report["mean"]["psnr"])
    assert widths == [3 * 80, 3 * 160, 3 * 80]
    assert psnr[1] > psnr[0] + 1  # the data show what the file does, at twice the size
    assert psnr[0] == psnr[2]
    with pytest.raises(InputError, match="downscale"):
        evaluate_file(scene, data, ("cam01",), downscale=0.5)


def test_what_cannot_be_evaluated(clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path) -> None:
    scene, data, _, _ = clip
    with pytest.raises(InputError, match="cam07"):
        evaluate_file(scene, data, ("cam07",))
    with pytest.raises(InputError, match="does not exist"):
        evaluate_file(scene, tmp_path / "nothing", ("cam00",))
    (tmp_path / "cut.slod").write_bytes(scene.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"cut\.slod: is cut short"):
        evaluate_file(tmp_path / "cut.slod", data, ("cam00",))
    scene.with_name("a.slod.json").write_text("{")
    with pytest.raises(InputError, match=r"a\.slod\.json: cannot be read"):
        evaluate_file(scene, data, ("cam00",))
    scene.with_name("a.slod.json").unlink()


def test_frames_without_a_picture_of_each_camera_are_left_out_and_counted(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path
) -> None:
    scene, data, scenes, _ = clip
    shutil.copytree(data, tmp_path / "data")
    large = next(camera for camera in scenes[0].header.cameras if camera.name == "cam01").scaled(160, 96)
    write_video(tmp_path / "data" / "cam01.mp4", [Splatter().picture(state, large) for state in scenes[:2]])
    text = evaluate(scene, tmp_path / "data", ("cam01",), tmp_path / "report.json")
    left_out = f"of the others {tmp_path / 'data'} has no picture from each camera that is measured:"
    assert text.startswith(f"2 of 4 frames, means over the held-out cameras; {left_out}")
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["frames"], report["file_frames"]) == (2, 4)
    assert evaluate(scene, data, ("cam01",)).startswith("4 frames, means over the held-out cameras:")


def test_a_camera_that_stood_upright_among_lying_ones_is_measured_where_it_stood(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = clip[2][0]
    *lying, last = state.header.cameras
    cameras = [*lying, last.turned()]
    write_clip(tmp_path / "a.slod", [replace(state, header=replace(state.header, cameras=tuple(cameras)))])
    entries = [(f"{camera.name}.png", camera, "PINHOLE") for camera in cameras]
    write_colmap_binary(tmp_path / "data" / "sparse" / "0", entries, np.zeros((0, 6)))
    for camera in cameras:
        write_picture(tmp_path / "data" / "images" / f"{camera.name}.png", Splatter().picture(state, camera))
    report = evaluate_file(tmp_path / "a.slod", tmp_path / "data", ())
    assert min(place["psnr"] for place in report["places"]["at"].values()) > 45
    assert "stand elsewhere" not in caplog.text


def test_a_recording_of_another_rig_is_told(
    clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    scene, data, scenes, _ = clip
    evaluate(scene, data, ("cam01",))
    assert "stand elsewhere" not in caplog.text
    shutil.copytree(data, tmp_path / "data")
    cameras = [camera.scaled(160, 96) for camera in scenes[0].header.cameras]
    np.save(tmp_path / "data" / "poses_bounds.npy", llff_rows(cameras[::-1]))
    evaluate(scene, tmp_path / "data", ("cam01",))
    assert "stand elsewhere than those of the file (cam" in caplog.text


def test_side_by_side_shows_the_difference() -> None:
    truth, drawn = np.full((2, 2, 3), 100, np.uint8), np.full((2, 2, 3), 90, np.uint8)
    joined = side_by_side(truth, drawn)
    assert joined.shape == (2, 6, 3)
    assert [int(joined[0, column, 0]) for column in (0, 2, 4)] == [100, 90, 40]
    assert int(side_by_side(truth, np.full((2, 2, 3), 255, np.uint8))[0, 4, 0]) == 255


def test_export_of_a_sequence(clip: tuple[Path, Path, list[Scene], list[bytes]], tmp_path: Path) -> None:
    scene = clip[0]
    text = export(scene, 1, "average", "ply", tmp_path / "out", sequence=True)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"frame_{n:05d}.ply" for n in (1, 2, 3)]
    assert "3 snapshots" in text
    assert b"averaged over the rig" in (tmp_path / "out" / "frame_00001.ply").read_bytes()[:200]
    assert "as seen from cam01" in export(scene, 2, "cam01", "spz", tmp_path / "one.spz")
    with pytest.raises(InputError, match="frames 0 to 3"):
        export(scene, 9, "average", "ply", tmp_path / "nine.ply")
    with pytest.raises(InputError, match="cam77"):
        export(scene, 0, "cam77", "ply", tmp_path / "x.ply")
    assert not (tmp_path / "x.ply").exists()
