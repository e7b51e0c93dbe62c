"""Decodes a video file into the pictures that can be shown: none that is damaged, or built upon one that is.

Pictures from the damage to the next keyframe are missing (`reach`), and the log says so once a file. Damage that a
decoder takes for sense cannot be noticed: those of HEVC, VP9 and JPEG hardly check anything.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import av
import av.container
import av.video.stream
from av.video.frame import PictureType

from streamlod.core.data.video.damage import Damage
from streamlod.core.data.video.reach import Reach
from streamlod.core.data.video.times import PictureTimes

_LATEST_BEGIN_NS = 5_000_000_000
_MAX_HELD = 16  # B-pictures in a row; some encoders make nothing else


def timed_pictures(
    container: av.container.InputContainer, stream: av.video.stream.VideoStream, rate: Fraction
) -> Iterator[tuple[int, av.VideoFrame]]:
    """The pictures that can be shown, each with its time in nanoseconds from the file's beginning.

    Args:
        container, stream, rate: as in `PictureTimes`.

    Raises:
        av.FFmpegError: the file cannot be read on.
    """
    decoding = _Decoding(stream, PictureTimes(container, stream, rate))
    try:
        for packet in container.demux(stream):
            yield from decoding.put(packet)
        yield from decoding.end()
    finally:
        decoding.damage.tell(container.name)


def played_pictures(
    container: av.container.InputContainer, stream: av.video.stream.VideoStream, rate: Fraction
) -> Iterator[tuple[int, av.VideoFrame]]:
    """Pictures of a played file, see `timed_pictures`, with their times from where it is played."""
    begin_ns: int | None = None
    for time_ns, frame in timed_pictures(container, stream, rate):
        if begin_ns is None:
            begin_ns = played_from(time_ns)
        yield time_ns - begin_ns, frame


def played_from(first_ns: int) -> int:
    """The time from which a file is played: nobody waits for a first picture with a time of another clock."""
    return first_ns if abs(first_ns) > _LATEST_BEGIN_NS else 0


class _Decoding:
    """One pass through a file."""

    def __init__(self, stream: av.video.stream.VideoStream, times: PictureTimes) -> None:
        self.damage = Damage()
        self._stream, self._times = stream, times
        self._reach = Reach()
        self._held: list[tuple[int, av.VideoFrame]] = []  # B-pictures, which may be built upon the one that follows

    def put(self, packet: av.Packet[Any]) -> Iterator[tuple[int, av.VideoFrame]]:
        """Pictures that can be shown when the decoder has got the packet."""
        time_ns = self._times.sample(packet) if packet.size > 0 else None
        if time_ns is not None:
            self.damage.awaited.append(time_ns)
            self._reach.sample(packet, time_ns)
        if not self._times.decodable:
            return
        try:
            frames = None if packet.is_corrupt else packet.decode()
        except av.FFmpegError:
            frames = None
        if frames is None:
            yield from self._begin_anew()
            self._reach.forget()
            self.damage.happen()
            return
        self._reach.decoded()
        yield from self._shown(frames)

    def end(self) -> Iterator[tuple[int, av.VideoFrame]]:
        """Pictures that waited for one after them."""
        yield from self._held
        self._held = []

    def _begin_anew(self) -> Iterator[tuple[int, av.VideoFrame]]:
        """Take what the decoder still has, and make it forget the rest."""
        with contextlib.suppress(av.FFmpegError):
            yield from self._shown(self._stream.decode(None))
        yield from self.end()
        self._stream.codec_context.flush_buffers()
        if self._times.counted:  # which pictures come before the next keyframe is not known
            self._times.lose()

    def _shown(self, frames: Sequence[Any]) -> Iterator[tuple[int, av.VideoFrame]]:
        for frame in frames:
            assert isinstance(frame, av.VideoFrame)
            time_ns = self._times.picture(frame)
            if frame.is_corrupt:
                if self._reach.begins_at(frame):
                    self._held = []
                    self.damage.happen()
                continue
            if time_ns is None or self._reach.includes(frame, time_ns):
                continue
            self._held.append((time_ns, frame))
            waits = frame.pict_type == PictureType.B and len(self._held) <= _MAX_HELD
            while self._held and not waits:
                self.damage.show(self._held[0][0])
                yield self._held.pop(0)
