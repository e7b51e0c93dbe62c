"""When the pictures of a video file were taken, in time from the file's beginning, and which of them can be shown.

A file may hold more samples than pictures: those that an edit list hides, and those before its first keyframe, or shown
before it, which refer to pictures that the file does not have.
"""

from __future__ import annotations

from collections import deque
from fractions import Fraction
from typing import Any

import av
import av.container
import av.stream
import av.video.stream

_SECOND_NS = 1_000_000_000
_IN_ORDER = "avi"  # has a time for each sample in their order, and none for the pictures
_CHUNK_HEAD = 8  # bytes of an AVI's chunk before its sample
_UNTIMED = {"h264", "hevc", "vvc", "m4v", "mpegvideo", "mjpeg", "mpjpeg", "obu"}  # FFmpeg supposes a rate for these
OWN_CLOCK = {"mpegts", "mpeg"}  # formats whose time does not begin at 0


def pictures_of(container: av.container.InputContainer) -> av.video.stream.VideoStream | None:
    """The video in a file, of several the one that players show, as the file says or else the first.

    None where it holds none that can be decoded but a still picture beside its sound.
    """
    videos = [
        stream
        for stream in container.streams.video
        if getattr(stream, "codec_context", None) is not None  # a codec that FFmpeg has
        and not stream.disposition & av.stream.Disposition.attached_pic
    ]
    return next((s for s in videos if s.disposition & av.stream.Disposition.default), next(iter(videos), None))


class PictureTimes:
    """The times of one file's samples and pictures, which must be asked about in the file's order.

    Presentation times count from the beginning of the file as players do. Two muxers' habits are undone: transport
    streams begin at any time; and where decoding begins at 0, what the order of decoding delays is no real delay.
    Formats without presentation times are counted: their pictures are shown in the order of their samples.

    Args:
        container, stream: the file and its video.
        rate: pictures a second of a file that has no times at all.

    Attributes:
        counted: whether pictures have no times of their own.
    """

    def __init__(
        self, container: av.container.InputContainer, stream: av.video.stream.VideoStream, rate: Fraction
    ) -> None:
        self._format = container.format.name
        self.counted = self._format in {_IN_ORDER, *_UNTIMED}
        self._base: Fraction = stream.time_base or Fraction(1, _SECOND_NS)
        self._rate, self._count = rate, 0
        self._waiting: deque[int] = deque()
        self._index, self._row = stream.index_entries, 0
        self._first_ns: int | None = None  # of the first keyframe
        self._key_ns: int | None = None  # of the keyframe with which the decoder began
        self._origin_ns: int | None = None
        if self._format in OWN_CLOCK and container.start_time is not None:
            self._origin_ns = _nanoseconds(container.start_time, Fraction(1, av.time_base))

    def sample(self, packet: av.Packet[Any]) -> int | None:
        """The time of the picture in a sample; None where an undamaged file would not show it.

        Samples before the first keyframe must not be given to a decoder, as some decoders make pictures of them.
        """
        if self._origin_ns is None:
            delayed = packet.dts == 0 and packet.pts is not None and packet.pts > 0
            self._origin_ns = _nanoseconds(packet.pts or 0, self._base) if delayed else 0
            self.counted = self.counted or packet.pts is None
        number, self._count = self._count, self._count + 1
        if self._first_ns is None and not packet.is_keyframe:
            return None
        if not self.counted:
            time_ns = None if packet.pts is None else _nanoseconds(packet.pts, self._base) - self._origin_ns
        elif self._format == _IN_ORDER and (order := self._order_of(packet)) is not None:
            time_ns = _nanoseconds(order, self._base)
        else:
            time_ns = round(number * _SECOND_NS / self._rate)
        if time_ns is None:
            return None
        self._first_ns = time_ns if self._first_ns is None else self._first_ns
        if self._key_ns is None and packet.is_keyframe:
            self._key_ns = time_ns
        if self.counted and self.decodable:
            self._waiting.append(time_ns)
        return None if packet.is_discard or time_ns < self._first_ns else time_ns

    def _order_of(self, packet: av.Packet[Any]) -> int | None:
        """The number of an AVI's sample by the file's index, as FFmpeg's own count misses those that it cannot read."""
        wanted = -1 if packet.pos is None else packet.pos - _CHUNK_HEAD
        while self._row < len(self._index) and self._index[self._row].pos < wanted:
            self._row += 1
        known = self._row < len(self._index) and self._index[self._row].pos == wanted
        return self._index[self._row].timestamp if known else packet.dts

    def lose(self) -> None:
        """The decoder begins anew: nothing can be shown until the next keyframe."""
        self._key_ns = None
        self._waiting.clear()

    @property
    def decodable(self) -> bool:
        """Whether a keyframe has come."""
        return self._key_ns is not None

    def picture(self, frame: av.VideoFrame) -> int | None:
        """The time of a decoded picture; None where it must not be shown."""
        if self.counted:
            return self._waiting.popleft() if self._waiting else None
        if frame.pts is None or self._key_ns is None or self._origin_ns is None:
            return None
        time_ns = _nanoseconds(frame.pts, frame.time_base or self._base) - self._origin_ns
        return None if time_ns < self._key_ns else time_ns


def _nanoseconds(ticks: int, base: Fraction) -> int:
    return ticks * _SECOND_NS * base.numerator // base.denominator
