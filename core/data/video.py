"""Video files: what they say about themselves, and their pictures one at a time."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import av
import av.container
import numpy as np

from streamlod.core.arrays import UInt8
from streamlod.core.data.pictures import MAX_SIDE
from streamlod.core.errors import InputError

SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi")


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """width, height in pixels; fps pictures a second; frame_count pictures in the file."""

    width: int
    height: int
    fps: float
    frame_count: int


def probe_video(path: Path) -> VideoInfo:
    """What the file's headers say; checks that the file is as long as its index.

    Raises:
        InputError: missing, not a video, cut short, or of a size that is refused.
    """
    with contextlib.closing(_open(path)) as container:
        stream = container.streams.video[0]
        width, height = stream.codec_context.width, stream.codec_context.height
        if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
            raise InputError(path, f"video of {width}x{height} is refused; the limit is {MAX_SIDE} pixels a side")
        size = path.stat().st_size
        if any(entry.pos + entry.size > size for entry in stream.index_entries):
            raise InputError(path, "ends before its last picture; the file is cut short, copy it again")
        rate = stream.average_rate or stream.guessed_rate
        if not rate:
            raise InputError(path, "does not say its frame rate; write it again with ffmpeg -r FPS")
        return VideoInfo(width, height, float(rate), stream.frames or _count_packets(container, path))


def read_video(path: Path, start: int = 0) -> Generator[UInt8, None, None]:
    """[H,W,3] RGB pictures from number `start` on, decoded one at a time; closes the file when done or dropped.

    Raises:
        InputError: missing, not a video, or bytes that do not decode.
    """
    with contextlib.closing(_open(path)) as container:
        stream = container.streams.video[0]
        # one thread a file: a rig decodes many files side by side, and each thread would hold pictures of its own
        stream.codec_context.thread_count = 1
        try:
            for number, frame in enumerate(container.decode(stream)):
                if number >= start:
                    yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)
        except av.FFmpegError as error:
            raise InputError(path, f"cannot be decoded ({error.strerror}); copy it again") from error


def _open(path: Path) -> av.container.InputContainer:
    try:
        container = av.open(str(path.absolute()), options={"protocol_whitelist": "file"})
    except OSError as error:  # av's errors are OSErrors or ValueErrors
        raise InputError(path, f"cannot be opened as a video: {error.strerror}") from error
    except (av.FFmpegError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "the bytes are not those of a video"
        raise InputError(path, f"cannot be opened as a video: {reason}") from error
    if not container.streams.video:
        container.close()
        raise InputError(path, "holds no pictures, only other streams")
    return container


def _count_packets(container: av.container.InputContainer, path: Path) -> int:
    """For containers without an index (Matroska), the number of pictures is known only after reading all."""
    try:
        return sum(packet.size > 0 for packet in container.demux(container.streams.video[0]))
    except av.FFmpegError as error:
        raise InputError(path, f"cannot be read to its end ({error.strerror}); copy it again") from error
