"""Which pictures of a file can be shown, and when they were taken; `picture` writes its number into each."""

from __future__ import annotations

import subprocess
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.data.video import probe_video, read_video
from streamlod.core.data.video.decoding import timed_pictures
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from tests.core.data.writers import copy_video, picture, read_back, write_picture, write_video

PICTURES = [picture(0, t) for t in range(24)]
GROUPS = {"g": "8", "x264-params": "scenecut=0:open-gop=0"}
B_FRAMES = {"g": "8", "bf": "2", "x264-params": "scenecut=0:bframes=2:b-adapt=0"}
OPEN = {"g": "8", "bf": "2", "x264-params": "open-gop=1:scenecut=0:bframes=2:b-adapt=0:keyint=8:min-keyint=8"}


def _seen(path: Path, fps: float = 30) -> dict[int, int]:
    """The number of the picture shown at each time, in periods; the index must agree."""
    found = {}
    for time_ns, frame in read_video(path):
        number = round(time_ns * fps / 1e9)
        assert abs(time_ns - number * 1e9 / fps) < 1e6  # Matroska counts milliseconds
        found[number] = read_back(upright(frame))[1]
    assert [round(time_ns * fps / 1e9) for time_ns in probe_video(path).times_ns] == list(found)
    return found


@pytest.mark.parametrize("options", [GROUPS, B_FRAMES, OPEN], ids=["no B-frames", "B-frames", "open groups"])
@pytest.mark.parametrize(
    ("suffix", "muxing"),
    [
        (".mp4", {}),
        (".mp4", {"use_editlist": "0"}),
        (".mp4", {"movflags": "frag_keyframe+empty_moov"}),
        (".mov", {}),
        (".mkv", {}),
        (".avi", {}),
        (".ts", {}),
        (".flv", {}),
    ],
)
def test_every_container_gives_each_picture_its_time(
    tmp_path: Path, suffix: str, muxing: dict[str, str], options: dict[str, str]
) -> None:
    path = tmp_path / f"cam{suffix}"
    write_video(path, PICTURES, options=options, muxing=muxing)
    assert _seen(path) == {t: t for t in range(24)}
    assert probe_video(path).fps == 30


@pytest.mark.parametrize("options", [GROUPS, B_FRAMES, OPEN], ids=["no B-frames", "B-frames", "open groups"])
def test_samples_that_an_edit_list_hides_are_not_counted(tmp_path: Path, options: dict[str, str]) -> None:
    write_video(tmp_path / "whole.mp4", PICTURES, options=options)
    copy_video(tmp_path / "whole.mp4", tmp_path / "cut.mp4", earlier=3)
    assert _seen(tmp_path / "cut.mp4") == {t: t + 3 for t in range(21)}
    assert probe_video(tmp_path / "cut.mp4").frame_count == 21


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".ts"])
@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_a_file_joined_in_mid_group_begins_with_its_first_keyframe(tmp_path: Path, suffix: str, codec: str) -> None:
    options = {"x265-params": "keyint=8:min-keyint=8:scenecut=0:bframes=0:log-level=none", **GROUPS}
    write_video(tmp_path / "whole.mp4", PICTURES, codec=codec, options=options if codec != "mpeg4" else {"g": "8"})
    copy_video(tmp_path / "whole.mp4", tmp_path / f"joined{suffix}", skip=5)
    found = _seen(tmp_path / f"joined{suffix}")
    origin = min(found) - found[min(found)]  # transport streams begin with their first sample
    assert origin == (-5 if suffix == ".ts" else 0)
    assert found == {t + origin: t for t in range(8, 24)}


def test_a_decoder_that_shows_anything_gets_no_sample_before_the_first_keyframe(tmp_path: Path) -> None:
    """FFmpeg's decoder of MPEG-4 part 2 makes grey pictures of such samples."""
    write_video(tmp_path / "whole.mp4", PICTURES, codec="mpeg4", options={"g": "8"})
    copy_video(tmp_path / "whole.mp4", tmp_path / "joined.mkv", skip=5)
    found = _seen(tmp_path / "joined.mkv")
    assert list(found) == list(range(8, 24))
    assert all(abs(time - number) <= 1 for time, number in found.items())  # four grey levels a picture, coded coarsely


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("codec", ["libx264", "libx265"])
def test_pictures_before_an_open_groups_keyframe_are_not_shown(tmp_path: Path, suffix: str, codec: str) -> None:
    """Two B-frames after the keyframe are shown before it, and refer to the group before, which is not there."""
    open_groups = "open-gop=1:keyint=8:min-keyint=8:scenecut=0:bframes=2:b-adapt=0"
    options = {"x265-params": f"{open_groups}:log-level=none"} if codec == "libx265" else {"x264-params": open_groups}
    write_video(tmp_path / "whole.mp4", PICTURES, codec=codec, options=options)
    with av.open(str(tmp_path / "whole.mp4")) as container:
        keys = [n for n, packet in enumerate(container.demux(video=0)) if packet.is_keyframe and packet.size]
    assert len(keys) > 1
    copy_video(tmp_path / "whole.mp4", tmp_path / f"joined{suffix}", skip=keys[1])
    found = _seen(tmp_path / f"joined{suffix}")
    assert all(time == number for time, number in found.items())
    assert max(found) == 23
    assert 15 <= len(found) <= 17


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("options", [GROUPS, B_FRAMES], ids=["no B-frames", "B-frames"])
def test_a_first_picture_that_starts_late_is_late(tmp_path: Path, suffix: str, options: dict[str, str]) -> None:
    path = tmp_path / f"cam{suffix}"
    write_video(path, PICTURES, times=[t + 5 for t in range(24)], options=options)
    assert _seen(path) == {t + 5: t for t in range(24)}


def test_lost_pictures_leave_a_gap_and_the_rate_as_it_is(tmp_path: Path) -> None:
    kept = [t for t in range(24) if t not in (7, 8, 15)]
    for suffix in (".mp4", ".mkv"):
        path = tmp_path / f"cam{suffix}"
        times = [t * 1000 // 30 for t in kept]
        write_video(path, [PICTURES[t] for t in kept], times=times, time_base=Fraction(1, 1000))
        assert _seen(path) == {t: t for t in kept}
        assert probe_video(path).fps == 30


def test_a_file_without_times_is_counted_at_the_rate_given(tmp_path: Path) -> None:
    path = tmp_path / "cam.h264"
    write_video(path, PICTURES, options=B_FRAMES)
    with av.open(str(path)) as container:
        pictures = list(timed_pictures(container, container.streams.video[0], Fraction(25)))
    assert [time_ns for time_ns, _ in pictures] == [t * 40_000_000 for t in range(24)]
    assert [read_back(upright(frame))[1] for _, frame in pictures] == list(range(24))


@pytest.mark.parametrize("apart", [10**9, 10**12, 1])
def test_times_that_no_camera_has_are_refused(tmp_path: Path, apart: int) -> None:
    path = tmp_path / "cam.mkv"
    write_video(path, PICTURES[:3], times=[0, apart, 2 * apart], time_base=Fraction(1, 1000))
    if apart == 1:
        assert probe_video(path).fps == 1000
        return
    with pytest.raises(InputError, match=r"cam\.mkv: (has .* pictures a second|does not say its frame rate)"):
        probe_video(path)


def test_a_file_without_any_keyframe_is_refused(tmp_path: Path) -> None:
    write_video(tmp_path / "whole.mp4", PICTURES[:6], options={"g": "30"})
    copy_video(tmp_path / "whole.mp4", tmp_path / "joined.mkv", skip=2)
    with pytest.raises(InputError, match=r"joined\.mkv: holds no picture that can be decoded"):
        probe_video(tmp_path / "joined.mkv")


def test_a_still_picture_that_goes_with_sound_is_no_video(tmp_path: Path) -> None:
    """Recorders put a small picture before the video, players of music a cover."""
    sound, cover, still = tmp_path / "sound.m4a", tmp_path / "cover.jpg", tmp_path / "still.mp4"
    write_picture(cover, picture(5, 5, (32, 32)))
    write_video(tmp_path / "cam.mp4", PICTURES[:6])
    quiet = ["ffmpeg", "-loglevel", "error", "-f", "lavfi", "-i", "anullsrc=r=8000:cl=mono", "-t", "1", "-c:a", "aac"]
    subprocess.run([*quiet, str(sound)], check=True)
    join = ["ffmpeg", "-loglevel", "error", "-i", str(cover), "-i"]
    as_cover = ["-map", "0", "-map", "1", "-c", "copy", "-disposition:v:0", "attached_pic"]
    subprocess.run([*join, str(sound), *as_cover, str(still)], check=True)
    with pytest.raises(InputError, match=r"still\.mp4: holds no pictures, only other streams"):
        probe_video(still)
    subprocess.run([*join, str(tmp_path / "cam.mp4"), *as_cover, str(tmp_path / "both.mp4")], check=True)
    assert _seen(tmp_path / "both.mp4") == {t: t for t in range(6)}


def test_a_file_with_sound_before_its_pictures(tmp_path: Path) -> None:
    """Sound from 0 on, pictures from a tenth of a second on, as cameras write them."""
    path = tmp_path / "cam.mp4"
    with av.open(str(path), "w") as container:
        sound = container.add_stream("aac", rate=8000)
        video = container.add_stream("libx264", rate=30, options={"preset": "ultrafast", "crf": "4"})
        video.width, video.height, video.pix_fmt = 96, 64, "yuv444p"
        for number in range(8):
            samples = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            samples.sample_rate, samples.pts = 8000, 1024 * number
            container.mux(sound.encode(samples))
        for number in range(6):
            frame = av.VideoFrame.from_ndarray(picture(0, number), format="rgb24")
            frame.pts, frame.time_base = number + 3, Fraction(1, 30)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        container.mux(sound.encode(None))
    assert _seen(path) == {t + 3: t for t in range(6)}


def test_of_two_videos_in_a_file_the_one_that_players_show_counts(tmp_path: Path) -> None:
    write_video(tmp_path / "other.mp4", PICTURES[6:12])
    write_video(tmp_path / "cam.mp4", PICTURES[:6])
    both = ["ffmpeg", "-loglevel", "error", "-i", str(tmp_path / "other.mp4"), "-i", str(tmp_path / "cam.mp4")]
    shown = ["-map", "0", "-map", "1", "-c", "copy", "-disposition:v:0", "0", "-disposition:v:1", "default"]
    subprocess.run([*both, *shown, str(tmp_path / "both.mp4")], check=True)
    assert _seen(tmp_path / "both.mp4") == {t: t for t in range(6)}
