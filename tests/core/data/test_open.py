"""Detection of layouts, and files that are not what they should be: one sentence that names file and fault."""

from __future__ import annotations

import logging
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.data import LAYOUTS, open_dataset
from streamlod.core.errors import InputError
from tests.core.data.writers import (
    llff_rows,
    picture,
    read_back,
    rig,
    write_caliscope,
    write_colmap_binary,
    write_picture,
    write_transforms,
    write_video,
    write_video_clip,
)

NAMES = ("cam00", "cam01", "cam02")


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    folder = tmp_path / "clip"
    write_video_clip(folder, NAMES, frames=6)
    return folder


def _mixed(folder: Path) -> None:
    """A folder that is an N3DV clip and a COLMAP data set at once."""
    write_video_clip(folder, NAMES, frames=2)
    write_colmap_binary(
        folder / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], np.zeros((0, 6))
    )
    for index, name in enumerate(NAMES):
        write_picture(folder / "images" / f"{name}.png", picture(index, 0))


def test_the_layout_is_detected_and_can_be_overridden(tmp_path: Path) -> None:
    _mixed(tmp_path)
    assert open_dataset(tmp_path).layout == "n3dv"
    assert open_dataset(tmp_path, layout="colmap").layout == "colmap"
    write_transforms(tmp_path, [f"images/{name}.png" for name in NAMES], rig(NAMES))
    assert open_dataset(str(tmp_path)).layout == "transforms"
    write_caliscope(tmp_path / "c", rig(["cam_0"]), [[True]])
    assert open_dataset(tmp_path / "c").layout == "caliscope"
    with pytest.raises(InputError, match="holds no video called like cam_0"):
        open_dataset(tmp_path, layout="meetroom")
    with pytest.raises(InputError, match=f"layout: must be one of {', '.join(LAYOUTS)}"):
        open_dataset(tmp_path, layout="video")


@pytest.mark.parametrize("downscale", [0, 0.5, -2, float("nan"), 1000])
def test_downscale_is_checked(clip: Path, downscale: float) -> None:
    with pytest.raises(InputError, match="downscale: must lie between"):
        open_dataset(clip, downscale=downscale)


def test_cameras_that_do_not_exist(clip: Path) -> None:
    with pytest.raises(InputError, match=r"clip: has no camera 'cam07'; it has cam00, cam01, cam02"):
        open_dataset(clip, cameras=["cam07"])
    with pytest.raises(InputError, match="each only once"):
        open_dataset(clip, cameras=["cam00", "cam00"])
    with pytest.raises(InputError, match="at least one camera"):
        open_dataset(clip, cameras=[])


def test_folders_that_hold_nothing_usable(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere: does not exist"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(InputError, match="is an empty folder"):
        open_dataset(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=r"notes\.txt: is not a folder"):
        open_dataset(tmp_path / "notes.txt")
    with pytest.raises(InputError, match=r"in a known layout; it needs .* as streamlod calibrate makes"):
        open_dataset(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", llff_rows(rig(NAMES)))
    with pytest.raises(InputError, match=r"holds no video called like cam00\.mp4"):
        open_dataset(tmp_path)


def _row(change: Callable[[np.ndarray], None]) -> np.ndarray:
    rows = llff_rows(rig(NAMES))
    change(rows)
    return rows


def _set(row: int, column: int, value: float) -> Callable[[np.ndarray], None]:
    return lambda rows: rows.__setitem__((row, column), value)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((3, 16)), r"must have shape Nx17, a row for each camera, not 3x16"),
        (np.zeros(17), r"must have shape Nx17, a row for each camera, not 17"),
        (np.zeros(()), r"not a single number"),
        (np.zeros((0, 17)), r"has 0 rows, but there are 3 videos \(cam00, cam01, cam02\)"),
        (llff_rows(rig(NAMES))[:2], r"has 2 rows, but there are 3 videos"),
        (_row(_set(1, 3, np.nan)), r"camera cam01: row 1 holds numbers that are not finite"),
        (_row(_set(2, 16, np.inf)), r"camera cam02: row 2 holds numbers that are not finite"),
        (_row(_set(1, 0, 3.0)), r"camera cam01: its pose does not hold a rotation"),
        (_row(_set(1, 14, 0.0)), r"camera cam01: focal length must be positive"),
        (_row(_set(1, 14, -5.0)), r"camera cam01: focal length must be positive"),
        (_row(_set(1, 4, 0.0)), r"camera cam01: picture size 96x0 is not possible"),
        (_row(_set(0, 15, -1.0)), r"its depth bounds: run from -1 to 9"),
        (np.array([["a"] * 17] * 3), r"does not hold an array of plain numbers"),
        (np.array([[None] * 17] * 3), r"does not hold an array of plain numbers"),
    ],
)
def test_faults_in_poses_bounds(clip: Path, array: np.ndarray, message: str) -> None:
    np.save(clip / "poses_bounds.npy", array)
    with pytest.raises(InputError, match=rf"poses_bounds\.npy: .*{message}"):
        open_dataset(clip)


def test_poses_that_do_not_fit_the_video(clip: Path) -> None:
    np.save(clip / "poses_bounds.npy", _row(_set(1, 4, 96.0)))
    with pytest.raises(InputError, match=r"cam01\.mp4: has 96x64 pixels, which does not fit the calibration's 96x96"):
        open_dataset(clip)


def test_poses_bounds_cut_at_any_byte_is_refused(clip: Path) -> None:
    path = clip / "poses_bounds.npy"
    data = path.read_bytes()
    for size in range(0, len(data), 7):
        path.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"poses_bounds\.npy: "):
            open_dataset(clip)


def test_a_pickle_is_not_run(clip: Path, tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    trap = np.empty(1, object)
    trap[0] = Trap()
    np.save(clip / "poses_bounds.npy", trap, allow_pickle=True)
    with pytest.raises(InputError, match=r"poses_bounds\.npy: does not hold an array of plain numbers"):
        open_dataset(clip)
    assert not (tmp_path / "sprung").exists()


def test_an_array_that_claims_more_than_its_file_holds(clip: Path) -> None:
    path = clip / "poses_bounds.npy"
    path.write_bytes(path.read_bytes().replace(b"(3, 17), }  ", b"(9999999999, 17), }")[:200])
    with pytest.raises(InputError, match=r"poses_bounds\.npy: "):
        open_dataset(clip)


def test_a_missing_video_leaves_rows_over(clip: Path) -> None:
    (clip / "cam01.mp4").unlink()
    with pytest.raises(InputError, match=r"poses_bounds\.npy: .*has 3 rows, but there are 2 videos \(cam00, cam02\)"):
        open_dataset(clip)


def test_videos_of_different_rate_or_size(clip: Path) -> None:
    write_video(clip / "cam02.mp4", [picture(2, t) for t in range(6)], fps=25)
    with pytest.raises(InputError, match=r"cam02\.mp4: runs at 25 pictures a second, but cam00\.mp4 at 30"):
        open_dataset(clip)
    write_video(clip / "cam02.mp4", [picture(2, t, (48, 32)) for t in range(6)])
    dataset = open_dataset(clip)
    assert {(camera.width, camera.height) for camera in dataset.cameras} == {(48, 32)}
    assert next(dataset.frames()).present.all()


def test_videos_with_the_suffixes_of_cameras_and_cutting_programs(clip: Path) -> None:
    (clip / "cam00.mp4").rename(clip / "cam00.m4v")
    (clip / "cam01.mp4").rename(clip / "cam01.MOV")
    (clip / "cam02.mp4").unlink()
    write_video(clip / "cam02.mts", [picture(2, t) for t in range(6)])
    dataset = open_dataset(clip)
    assert dataset.names == NAMES
    assert [read_back(image) for frame in dataset.frames() for image in frame.images] == [
        (camera, instant) for instant in range(6) for camera in range(3)
    ]


def test_a_folder_above_the_recording_says_which_is_one(clip: Path) -> None:
    (clip.parent / "notes").mkdir()
    (clip.parent / "again").symlink_to(clip.parent)
    with pytest.raises(InputError, match="is no recording, but holds clip; name that folder"):
        open_dataset(clip.parent)


@pytest.mark.parametrize(
    "content", [b"", b"not a video at all" * 50, b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:1/a.ts\n"]
)
def test_a_file_that_is_not_a_video(clip: Path, content: bytes) -> None:
    (clip / "cam01.mp4").write_bytes(content)
    with pytest.raises(InputError, match=r"cam01\.mp4: "):
        open_dataset(clip)


def test_a_file_with_sound_only(clip: Path) -> None:
    with av.open(str(clip / "cam01.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(InputError, match=r"cam01\.mp4: holds no pictures, only other streams"):
        open_dataset(clip)


@pytest.mark.parametrize("movflags", ["", "faststart"])
def test_a_video_cut_short_is_refused_or_names_the_file_while_reading(tmp_path: Path, movflags: str) -> None:
    """Index at the end: nothing can be opened. Index in front: the last pictures lie beyond the end."""
    write_video_clip(tmp_path, ("cam00",), frames=1)
    path = tmp_path / "cam00.mp4"
    noise = np.random.default_rng(0).integers(0, 256, (6, 64, 96, 3), np.uint8)
    with av.open(str(path), "w", options={"movflags": movflags} if movflags else {}) as container:
        stream = container.add_stream("mpeg4", rate=30)
        stream.height, stream.width, stream.pix_fmt = 64, 96, "yuv420p"
        for image in noise:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    data = path.read_bytes()
    assert len(list(open_dataset(tmp_path).frames())) == 6
    for tenths in range(10):
        path.write_bytes(data[: len(data) * tenths // 10])
        with pytest.raises(InputError, match=r"cam00\.mp4: "):
            list(open_dataset(tmp_path).frames())


@pytest.mark.long
def test_damage_inside_a_video_names_the_file_or_yields_every_frame(clip: Path) -> None:
    path = clip / "cam01.mp4"
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    for _ in range(40):
        damaged = data.copy()
        for at in rng.integers(0, len(data), 4):
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        assert _frames_or_none(clip) in (6, None)


def _frames_or_none(folder: Path) -> int | None:
    """How many frames the folder yields, or none when it is refused in the documented way."""
    try:
        return len(list(open_dataset(folder).frames()))
    except InputError:
        return None


def _assert_missing(folder: Path, caplog: pytest.LogCaptureFixture, instants: set[int]) -> None:
    for frame in open_dataset(folder).frames():
        assert frame.present.tolist() == [True, frame.index not in instants, True]
        seen = [read_back(image) for image, there in zip(frame.images, frame.present, strict=True) if there]
        assert seen == [(camera, frame.index) for camera in range(3) if frame.present[camera]]
    [told] = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert told == (
        f"camera cam01: has 48x32 pixels at instant {min(instants)}, not 96x64; "
        "its pictures of another size are left out"
    )


def test_a_video_that_turns_to_another_size_is_missing_meanwhile(clip: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As browsers record, whose pictures shrink with the line."""
    (clip / "cam01.mp4").unlink()
    sizes = [(96, 64), (96, 64), (48, 32), (48, 32), (48, 32), (96, 64)]
    with av.open(str(clip / "cam01.webm"), "w") as container:
        stream = container.add_stream("libvpx", rate=30)
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for number, size in enumerate(sizes):
            encoder = av.VideoCodecContext.create("libvpx", "w")
            encoder.width, encoder.height, encoder.pix_fmt = *size, "yuv420p"
            encoder.time_base, encoder.framerate = Fraction(1, 30), Fraction(30)
            encoder.options = {"crf": "4", "b": "4M", "deadline": "realtime"}
            frame = av.VideoFrame.from_ndarray(picture(1, number, size), format="rgb24")
            for packet in [*encoder.encode(frame), *encoder.encode(None)]:
                packet.pts = packet.dts = number
                packet.time_base, packet.stream = Fraction(1, 30), stream
                container.mux(packet)
    _assert_missing(clip, caplog, {2, 3, 4})


def test_a_picture_file_of_another_size_is_missing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_colmap_binary(
        tmp_path / "sparse" / "0", [(f"{c.name}.png", c, "PINHOLE") for c in rig(NAMES)], np.zeros((0, 6))
    )
    for instant in range(4):
        for index, name in enumerate(NAMES):
            size = (48, 32) if (index, instant) == (1, 2) else (96, 64)
            write_picture(tmp_path / "frames" / f"{instant:04d}" / f"{name}.png", picture(index, instant, size))
    _assert_missing(tmp_path, caplog, {2})
