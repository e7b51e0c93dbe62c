"""Video files: what they say, and their colours."""

from __future__ import annotations

import subprocess
from pathlib import Path

import av
import numpy as np
import pytest

from streamlod.core.data.video import probe_video, read_video
from streamlod.core.data.video.pairing import paired
from streamlod.core.data.video.upright import upright
from streamlod.core.errors import InputError
from tests.core.data.writers import picture, put_display_matrix, read_back, write_video


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_size_rate_and_count(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"cam{suffix}"
    write_video(path, [picture(0, t) for t in range(7)], fps=25)
    info = probe_video(path)
    assert (info.width, info.height, info.fps, info.frame_count) == (96, 64, 25.0, 7)  # Matroska keeps no count
    assert [read_back(upright(frame))[1] for _, frame in read_video(path)] == list(range(7))


@pytest.mark.parametrize(
    ("tag", "expected"), [(av.video.reformatter.Colorspace.ITU709, (250, 93, 20)), (None, (236, 81, 24))]
)
def test_colours_follow_the_files_matrix(tmp_path: Path, tag: object, expected: tuple[int, int, int]) -> None:
    """Y 120, Cb 80, Cr 200 in limited range, through the BT.709 and the (default) BT.601 matrix."""
    path = tmp_path / "cam.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p"
        frame = av.VideoFrame(64, 48, "yuv444p")
        for plane, value in zip(frame.planes, (120, 80, 200), strict=True):
            plane.update(bytes([value]) * plane.buffer_size)
        if tag is not None:
            frame.colorspace = stream.codec_context.colorspace = int(tag)  # type: ignore[call-overload]
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    ((_, frame),) = read_video(path)
    assert abs(upright(frame)[0, 0].astype(int) - expected).max() <= 2


def test_a_codec_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cam.mkv"
    write_video(path, [picture(0, t) for t in range(3)])
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_MPEG4/ISO/XXX"))
    with pytest.raises(InputError, match=r"cam\.mkv: holds no pictures"):
        probe_video(path)


def test_a_video_that_is_still_being_recorded_is_said_to_be(tmp_path: Path) -> None:
    path = tmp_path / "cam.mp4"
    write_video(path, [picture(0, t) for t in range(3)])
    path.write_bytes(path.read_bytes().partition(b"moov")[0])  # its index comes last
    with pytest.raises(InputError, match=r"cam\.mp4: is no video, or one that was cut off or is still being recorded"):
        probe_video(path)


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_damaged_bytes_are_read_or_refused(tmp_path: Path, suffix: str) -> None:
    """Above all those of headers and index, at either end of the file."""
    path, rng = tmp_path / f"cam{suffix}", np.random.default_rng(2)
    write_video(path, [picture(0, t) for t in range(6)], options={"bf": "2", "g": "3"})
    if suffix == ".mp4":
        put_display_matrix(path, 0, 1, -1, 0)
    whole = probe_video(path)
    data = path.read_bytes()
    read = 0
    for _ in range(60):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 5))):
            at = int(rng.choice([rng.integers(len(data)), rng.integers(600), len(data) - 1 - rng.integers(600)]))
            damaged[at] = int(rng.choice([0, 127, 128, 255, rng.integers(256)]))
        path.write_bytes(damaged)
        try:
            paired([path, path], [whole, probe_video(path)])
            read += sum(1 for _, frame in read_video(path) if upright(frame).size)
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017 - the sentence is one line, whatever is wrong
    assert read > 0


@pytest.mark.parametrize(("curve", "told"), [("arib-std-b67", "HDR video (HLG)"), ("smpte2084", "(PQ)"), ("bt709", "")])
def test_hdr_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture, curve: str, told: str) -> None:
    """Phones film HLG unless told otherwise: it is used as it is, and looks flat."""
    write_video(tmp_path / "cam.mp4", [picture(0, 0)], options={"color_trc": curve})
    probe_video(tmp_path / "cam.mp4")
    assert bool(caplog.messages) == bool(told)
    assert told in "".join(caplog.messages)


def test_interlaced_video_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_video(tmp_path / "cam.mp4", [picture(0, 0)], options={"flags": "+ilme+ildct"})
    probe_video(tmp_path / "cam.mp4")
    assert "is interlaced" in "".join(caplog.messages)


def test_transparent_video_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    make = ["ffmpeg", "-loglevel", "error", "-f", "lavfi", "-i", "color=red@0.5:s=96x64:d=0.1,format=yuva444p10le"]
    subprocess.run([*make, "-c:v", "prores_ks", "-profile:v", "4444", str(tmp_path / "cam.mov")], check=True)
    probe_video(tmp_path / "cam.mov")
    assert "is transparent, which is not used" in "".join(caplog.messages)
