"""Video files: what they say about themselves, and their pictures one at a time."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import av.container
import av.video.stream

from streamlod.core.camera.grid import MAX_RATE, MIN_RATE, rate_of
from streamlod.core.data.files import blaming
from streamlod.core.data.pictures import MAX_SIDE
from streamlod.core.data.video.decoding import timed_pictures
from streamlod.core.data.video.times import PictureTimes, pictures_of
from streamlod.core.data.video.upright import upright_size
from streamlod.core.errors import InputError

SUFFIXES = (
    *(".mp4", ".mkv", ".mov", ".webm", ".avi", ".m4v", ".ts", ".mts", ".m2ts", ".mpg", ".mpeg"),
    *(".mxf", ".3gp", ".wmv", ".flv", ".ogv"),
)
_HIGH_DYNAMIC_RANGE = {16: "PQ", 18: "HLG"}  # transfer characteristics of ITU-T H.273
_log = logging.getLogger(__name__)
ONE_CLOCK = "times are of one clock for all cameras"  # comment of a file of which this is so
MAX_PICTURES = 4_000_000  # of a file: a day and a half at 30 a second


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """A video, read without its pixels.

    Attributes:
        width, height: of its pictures in pixels, upright.
        fps: pictures a second where it is not interrupted.
        times_ns: when each picture that can be shown was taken, ascending, from the file's beginning.
        one_clock: whether other cameras' files of the same recording have the same beginning and clock.
    """

    width: int
    height: int
    fps: float
    times_ns: tuple[int, ...]
    one_clock: bool = False

    @property
    def frame_count(self) -> int:
        """Number of pictures."""
        return len(self.times_ns)


def probe_video(path: Path) -> VideoInfo:
    """Facts of the file; only its first picture is decoded.

    Raises:
        InputError: missing, not a video, cut short, of a size that is refused, or without a picture that decodes.
    """
    (width, height), begin_ns = _first_picture(path)
    with _opened(path) as (container, stream):
        size = path.stat().st_size
        if any(entry.pos + entry.size > size for entry in stream.index_entries):
            raise InputError(path, "ends before its last picture; the file is cut short, copy it again")
        one_clock = container.metadata.get("comment") == ONE_CLOCK
        rate = _declared_rate(stream, path)
        times, found = PictureTimes(container, stream, rate), []
        try:
            for packet in container.demux(stream):
                time_ns = times.sample(packet) if packet.size > 0 else None
                if time_ns is not None and time_ns >= begin_ns:
                    found.append(time_ns)
                if len(found) > MAX_PICTURES:
                    raise InputError(path, f"holds more than {MAX_PICTURES} pictures; cut it into parts")
        except av.FFmpegError as error:
            raise InputError(path, f"cannot be read to its end ({error.strerror}); copy it again") from error
    if not found:
        raise InputError(path, "holds no picture with a time")
    found.sort()
    fps = rate_of(found, rate)
    if not MIN_RATE <= fps <= MAX_RATE:
        raise InputError(path, f"has {fps:g} pictures a second; rates of {MIN_RATE:g} to {MAX_RATE:g} can be used")
    return VideoInfo(width, height, fps, tuple(found), one_clock)


def read_video(path: Path) -> Generator[tuple[int, av.VideoFrame], None, None]:
    """The pictures that can be shown, decoded one at a time, each with its time in nanoseconds as in `VideoInfo`.

    Closes the file when done or dropped.

    Raises:
        InputError: missing, not a video, or bytes that do not decode.
    """
    with _opened(path) as (container, stream):
        # one thread a file: a rig decodes many files side by side, and each thread would hold pictures of its own
        stream.codec_context.thread_count = 1
        stream.codec_context.options = {"max_pixels": str(MAX_SIDE**2)}
        try:
            yield from timed_pictures(container, stream, _declared_rate(stream, path))
        except av.FFmpegError as error:
            raise InputError(path, f"cannot be decoded ({error.strerror}); copy it again") from error


def _first_picture(path: Path) -> tuple[tuple[int, int], int]:
    """(width, height) of the first picture, upright, and its time."""
    with contextlib.closing(read_video(path)) as pictures:
        for time_ns, frame in pictures:
            if max(frame.width, frame.height) > MAX_SIDE:
                refused = f"video of {frame.width}x{frame.height} is refused"
                raise InputError(path, f"{refused}; the limit is {MAX_SIDE} pixels a side")
            if curve := _HIGH_DYNAMIC_RANGE.get(frame.color_trc):
                fault = "%s: is HDR video (%s), whose pictures will look flat; film without HDR, or convert it"
                _log.warning(fault, path, curve)
            if any(component.is_alpha for component in frame.format.components):
                _log.warning("%s: is transparent, which is not used: what lies under it is trained", path)
            if frame.interlaced_frame:
                _log.warning("%s: is interlaced, so that what moves has combs; deinterlace it with ffmpeg first", path)
            with blaming(path):
                return upright_size(frame), time_ns
    raise InputError(path, "holds no picture that can be decoded; it may be cut before its first keyframe")


def _declared_rate(stream: av.video.stream.VideoStream, path: Path) -> Fraction:
    for rate in (stream.guessed_rate, stream.average_rate):
        if rate is not None and MIN_RATE <= rate <= MAX_RATE:
            return rate
    raise InputError(path, "does not say its frame rate; write it again with ffmpeg -r FPS")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[av.container.InputContainer, av.video.stream.VideoStream]]:
    try:
        container = av.open(str(path.absolute()), options={"protocol_whitelist": "file"})
    except av.InvalidDataError as error:
        reason = "is no video, or one that was cut off or is still being recorded; let the recording end first"
        raise InputError(path, reason) from error
    except OSError as error:  # av's errors are OSErrors or ValueErrors
        raise InputError(path, f"cannot be opened as a video: {error.strerror}") from error
    except (av.FFmpegError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "the bytes are not those of a video"
        raise InputError(path, f"cannot be opened as a video: {reason}") from error
    with contextlib.closing(container):
        stream = pictures_of(container)
        if stream is None:
            raise InputError(path, "holds no pictures, only other streams")
        yield container, stream
