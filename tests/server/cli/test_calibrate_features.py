"""`streamlod calibrate --features`: a rendered place filmed by cameras side by side, and what cannot be calibrated."""

from __future__ import annotations

import json
import re
from contextlib import closing, nullcontext
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from streamlod.core.calibration.adjustment import rigid
from streamlod.core.calibration.sound.alike import RATE
from streamlod.core.calibration.trust import check_lens
from streamlod.core.data import open_dataset
from streamlod.core.data.lens import opencv_camera
from streamlod.core.data.video import read_video
from streamlod.core.errors import InputError
from streamlod.server.cli.main import app
from tests.clicks import write_sounding
from tests.core.calibration.alignment import differences
from tests.core.calibration.sound.claps import claps
from tests.core.data.writers import write_video, write_video_clip

CAMERAS = 5


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip with its true cameras."""
    folder = tmp_path_factory.mktemp("features") / "clip"
    size = ["--size", "640x360", "--frames", "2", "--cameras", str(CAMERAS)]
    done = CliRunner().invoke(app, ["synth", str(folder), *size])
    assert done.exit_code == 0, done.output
    return folder


def calibrated(filmed: Path, folder: Path, *arguments: str) -> str:
    """What the command prints; its files lie in `folder`."""
    pytest.importorskip("pycolmap", reason="calibration from features needs streamlod[features]")
    folder.mkdir()
    for file in filmed.glob("cam*.mp4"):
        (folder / file.name).symlink_to(file)
    done = CliRunner().invoke(app, ["calibrate", str(folder), "--features", *arguments])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.mark.long
def test_cameras_side_by_side_are_calibrated_without_a_board(filmed: Path, tmp_path: Path) -> None:
    truth = open_dataset(filmed).recording.cameras
    metres = float(np.linalg.norm(truth[0].centre - truth[3].centre))
    told = calibrated(filmed, tmp_path / "walk", "--apart", f"cam00:cam03={metres:.4f}")
    assert "transforms.json, rig.json and calibration.txt written" in told
    assert "no length is known" not in told
    steps = CAMERAS * (CAMERAS - 1) // 2 + CAMERAS - 1  # pairs, and cameras placed beside the first
    assert re.search(rf"placing the cameras: 100%.* {steps}/{steps} ", told)
    found = open_dataset(tmp_path / "walk").recording.cameras
    assert [camera.name for camera in found] == [camera.name for camera in truth]
    degrees, away = differences(*(np.array([rigid.pose(c.world_to_camera) for c in each]) for each in (found, truth)))
    assert degrees.max() < 0.3
    assert away.max() < 0.03
    heights = np.array([[camera.centre[2] for camera in each] for each in (found, truth)])
    np.testing.assert_allclose(heights[0] - heights[0].mean(), heights[1] - heights[1].mean(), atol=0.05)  # z is up
    focal = np.array([[camera.intrinsics[0, 0] for camera in each] for each in (found, truth)])
    np.testing.assert_allclose(focal[0], focal[1], rtol=0.02)


@pytest.mark.long
def test_cameras_begun_one_after_the_other_are_timed_by_what_they_heard(filmed: Path, tmp_path: Path) -> None:
    """All is dark until the last one is begun: by their own clocks, they would see little in common."""
    pytest.importorskip("pycolmap", reason="calibration from features needs streamlod[features]")
    folder, seconds = tmp_path / "walk", 8
    folder.mkdir()
    begins = {f"cam0{number}": begin for number, begin in enumerate((0.0, 1.2, 3.5, 0.0))}
    for number, (name, begin) in enumerate(begins.items()):
        with closing(read_video(filmed / f"{name}.mp4")) as pictures:
            light = next(pictures)[1].to_ndarray(format="rgb24")
        dark = np.zeros_like(light)
        lit = [light if begin + at / 10 >= 3.6 else dark for at in range(10 * seconds)]
        sound = None if number == 3 else claps(begin, seconds, number, at=(5.1, 6.45, 6.8))
        if sound is None:
            write_video(folder / f"{name}.mp4", lit, 10)
        else:
            write_sounding(folder / f"{name}.mp4", seconds, rate=RATE, pictures=lit, fps=10, sound=sound)
    done = CliRunner().invoke(app, ["calibrate", str(folder), "--features"])
    assert done.exit_code == 0, done.output
    assert "offsets are those of what cam00, cam01 and cam02 heard, good to 3 ms a metre" in done.output
    assert "of cam03 sound tells nothing" in done.output
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    told = {each["file_path"]: each["time_offset"] for each in frames}
    late = np.array([told[f"{name}.mp4"] for name in begins])
    assert late[:3] - late[0] == pytest.approx(list(begins.values())[:3], abs=0.005)


def test_a_lens_that_nothing_can_read_is_refused_before_it_is_written() -> None:
    """As webcams far apart gave it: bent so much by few features that the corners of its picture fold."""
    matrix = np.array([[991.0, 0, 639.5], [0, 991, 359.5], [0, 0, 1]])
    for bend, refused in ((-0.2, False), (-0.309, True)):
        camera = opencv_camera("cam_0", matrix, np.eye(4), (1280, 720), np.array([bend, 0, 0, 0, 0]))
        told = pytest.raises(InputError, match=r"cam_0: its lens does not follow from what was seen; walk a board")
        with told if refused else nullcontext():
            check_lens(camera, "what was seen; walk a board")


@pytest.mark.long
def test_known_lenses_are_kept_and_unknown_lengths_told(filmed: Path, tmp_path: Path) -> None:
    told = calibrated(filmed, tmp_path / "walk", "--lenses", str(filmed))
    assert "measure two cameras from lens to lens and give --apart cam00:cam01=METRES" in told
    found, truth = (open_dataset(each).recording.cameras for each in (tmp_path / "walk", filmed))
    for camera, other in zip(found, truth, strict=True):
        np.testing.assert_allclose(camera.intrinsics, other.intrinsics, rtol=1e-6)


def test_cameras_that_share_nothing_are_named(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap", reason="calibration from features needs streamlod[features]")
    write_video_clip(tmp_path, ["cam00", "cam01"], 2, (160, 120))
    refused = CliRunner().invoke(app, ["calibrate", str(tmp_path), "--features"])
    assert isinstance(refused.exception, InputError)
    assert "cameras cam00 and cam01: see too little of what the others see" in str(refused.exception)
    assert not (tmp_path / "transforms.json").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--features", "--board", "7x5"], "is for footage without a board"),
        (["--apart", "cam00:cam01=2"], "is for --features"),
        (["--features", "--apart", "cam00=2"], "is not CAMERA:CAMERA=METRES, such as cam00:cam01=1.85"),
        (["--features", "--apart", "cam00:cam01=0"], "is not CAMERA:CAMERA=METRES"),
        (["--features", "--apart", "cam00:left=2"], "does not name two of the cameras cam00, cam01"),
    ],
)
def test_unusable_arguments_are_refused(tmp_path: Path, arguments: list[str], sentence: str) -> None:
    write_video_clip(tmp_path, ["cam00", "cam01"], 2, (64, 48))
    refused = CliRunner().invoke(app, ["calibrate", str(tmp_path), *arguments])
    assert isinstance(refused.exception, InputError)
    assert sentence in str(refused.exception)
