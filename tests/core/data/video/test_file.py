"""Video files: what they say, and their colours."""

from __future__ import annotations

from pathlib import Path

import av
import pytest

from streamlod.core.data.video import probe_video, read_video
from streamlod.core.data.video.upright import upright
from tests.core.data.writers import picture, read_back, write_video


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
