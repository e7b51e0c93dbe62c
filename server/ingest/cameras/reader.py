"""Reads a camera's pictures with PyAV on a thread of its own, and reconnects until stopped."""

from __future__ import annotations

import contextlib
import logging
import struct
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any, Protocol

import av
import av.container
import av.video.stream

from streamlod.core.arrays import UInt8
from streamlod.core.camera.grid import period_of
from streamlod.core.data.video.times import pictures_of, played_pictures
from streamlod.core.data.video.upright import upright, upright_size
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address
from streamlod.server.ingest.cameras.opening import open_source
from streamlod.server.ingest.sync.clock import CaptureClock, CaptureTime, ClockSource, Sighting, read_timecode
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.timeline import Timeline

_LOG = logging.getLogger(__name__)
_MIN_DELAY, _MAX_DELAY = 0.25, 5.0  # seconds between attempts
_SETTLED_SECONDS = 5.0  # a connection that lasted so long resets the delay
ENDED = "it ended"
_LISTENS = "listening; its camera has not connected yet"
_REPORT_NS = 1_000_000_000


class Sink(Protocol):
    """Where pictures go. Called from the readers' threads."""

    def put(self, picture: Picture) -> None:
        """A picture has come."""

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        """A camera delivers nothing for now, or no more because its file has `ended`."""


class Reader:
    """Reads one camera on a thread.

    Args:
        camera: name.
        address: where its pictures come from.
        size: (width, height) that the calibration is for; other pictures are refused.
        fps: of the rig.
        sink: takes the pictures.
        timeline: the rig's.
        anchor_ns: capture time of the first picture of files; the same for all cameras.
        paced: whether files are played in real time.
    """

    def __init__(
        self,
        camera: str,
        address: Address,
        size: tuple[int, int],
        fps: float,
        sink: Sink,
        timeline: Timeline,
        *,
        anchor_ns: int,
        paced: bool = True,
    ) -> None:
        self.camera, self.connections = camera, 0
        self.clock: CaptureClock | None = None
        self._address, self._size, self._fps, self._sink, self._timeline = address, size, fps, sink, timeline
        self._anchor_ns, self._paced, self._sequence = anchor_ns, paced, 0
        self._stopping = threading.Event()
        self._abort: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name=f"camera {camera}", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end, which it does at the next picture or timeout."""
        self._stopping.set()
        self._abort()

    def join(self, seconds: float) -> None:
        """Wait at most so long for the thread's end; a listening port ends only by timeout."""
        self._thread.join(seconds)

    def _interruptible(self, abort: Callable[[], None]) -> None:
        self._abort = abort

    def _run(self) -> None:
        delay = _MIN_DELAY
        if self._address.listens:
            self._sink.gone(self.camera, _LISTENS, ended=False)
        while not self._stopping.is_set():
            begin, before, reason = time.monotonic(), self.connections, ENDED
            try:
                self._read()
            except InputError as error:
                reason = error.fault
            except (av.FFmpegError, OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or str(error)
            except Exception as error:  # keep the thread: the camera may come back
                _LOG.exception("camera %s", self.camera)
                reason = f"{type(error).__name__}: {error}"
            if self._stopping.is_set():
                return
            lasted = time.monotonic() - begin
            if self._address.listens and self.connections == before and lasted > _MIN_DELAY:
                reason = _LISTENS
            ended = not self._address.is_live  # read again, a file would be no better, or begin anew
            self._sink.gone(self.camera, reason, ended=ended)
            if ended:
                return
            if self._address.listens and lasted > _MIN_DELAY:
                continue  # the next camera may be connecting already
            delay = _MIN_DELAY if lasted > _SETTLED_SECONDS else delay
            self._stopping.wait(delay)
            delay = min(2 * delay, _MAX_DELAY)

    def _read(self) -> None:
        """One connection, from its beginning to its end."""
        with contextlib.ExitStack() as stack:
            container = open_source(self._address, self._fps, self._size, stack, self._interruptible)
            stream = pictures_of(container)
            if stream is None:
                raise InputError(f"camera {self.camera}", "its source holds no pictures, only other streams")
            stream.codec_context.thread_count = 1  # each further thread would delay pictures by one
            stream.codec_context.options = {"max_pixels": str(max_pixels(self._size))}
            width, height = stream.codec_context.width, stream.codec_context.height
            if (height, width) != self._size:  # else it may be turned upright, as its pictures will tell
                self._check_size(width, height)
            self.clock = CaptureClock(self._fps, expects_ntp=self._address.scheme in ("rtsp", "rtsps"))
            self.connections += 1
            if not self._address.is_live:
                self._play(container, stream)
                return
            for seen, frame in self._frames(container, stream, self.clock):
                if self._stopping.is_set():
                    return
                found = self.clock.capture(seen)
                if found is not None:
                    self._deliver(frame, found)

    def _play(self, container: av.container.InputContainer, stream: av.video.stream.VideoStream) -> None:
        """A file, at its pace; one without times at the rig's rate."""
        rate = 1_000_000_000 / period_of(self._fps)
        for since_begin_ns, frame in played_pictures(container, stream, rate):
            found = self._wait(since_begin_ns)
            if self._stopping.is_set() or found is None:
                return
            self._deliver(frame, found)

    def _check_size(self, width: int, height: int) -> None:
        """Refuse another size than the calibrated one; 0 stands for one that is not known yet."""
        if width and height and (width, height) != self._size:
            fault = f"delivers {width}x{height}, but is calibrated for {self._size[0]}x{self._size[1]}"
            raise InputError(f"camera {self.camera}", fault)

    def _frames(
        self, container: av.container.InputContainer, stream: av.video.stream.VideoStream, clock: CaptureClock
    ) -> Iterator[tuple[Sighting, av.VideoFrame]]:
        reported: tuple[int, int] | None = None
        for packet in container.demux(stream):
            arrival = self._timeline.now_ns()
            report = _report(packet)
            if report is not None and _is_news(report, reported):
                clock.observe_report(*report)
                reported = report
            for frame in packet.decode():
                assert isinstance(frame, av.VideoFrame)
                media = (
                    None if frame.pts is None or frame.time_base is None else _nanoseconds(frame.pts, frame.time_base)
                )
                yield Sighting(arrival, media, timecode_ns=_timecode(frame, self._fps)), frame

    def _wait(self, since_begin_ns: int) -> CaptureTime | None:
        """The capture time of a file's picture, when that time has come; None if stopped meanwhile."""
        capture = self._anchor_ns + since_begin_ns
        if self._paced and self._stopping.wait(max(0.0, (capture - self._timeline.now_ns()) / 1e9)):
            return None
        return CaptureTime(capture, ClockSource.FILE, 0)

    def _deliver(self, frame: av.VideoFrame, found: CaptureTime) -> None:
        self._check_size(*upright_size(frame))

        def load() -> UInt8:
            return upright(frame)

        self._sequence += 1
        picture = Picture(self.camera, found.capture_ns, found.source, found.error_ns, self._sequence, self._size, load)
        self._sink.put(picture)


def max_pixels(size: tuple[int, int]) -> int:
    """Largest picture that a decoder may allocate for a camera of (width, height): padded to whole blocks."""
    return (size[0] + 64) * (size[1] + 64)


def _report(packet: av.Packet[Any]) -> tuple[int, int] | None:
    """(presentation time, sender's wall clock) in nanoseconds, if the sender reports them (PyAV 18.1 and newer)."""
    if packet.pts is None or packet.time_base is None or not packet.has_sidedata("prft"):
        return None
    for data in packet.iter_sidedata():
        raw = _bytes(data)
        if str(data.data_type) == "prft" and len(raw) >= 8:
            microseconds = struct.unpack_from("<q", raw)[0]
            return _nanoseconds(packet.pts, packet.time_base), microseconds * 1000
    return None


def _is_news(report: tuple[int, int], last: tuple[int, int] | None) -> bool:
    """Whether to use a report: FFmpeg repeats the last one on all packets; one a second, and every change, is used."""
    if last is None or report[0] - last[0] >= _REPORT_NS or report[0] < last[0]:
        return True
    return abs((report[1] - report[0]) - (last[1] - last[0])) > 1_000_000


def _timecode(frame: av.VideoFrame, fps: float) -> int | None:
    data = frame.side_data.get("S12M_TIMECODE")
    if data is None:
        return None
    raw = _bytes(data)
    if len(raw) < 8:
        return None
    return read_timecode(struct.unpack_from("<I", raw, 4)[0], 1_000_000_000 / period_of(fps))


def _bytes(buffer: Any) -> bytes:
    return bytes(buffer)  # PyAV's type stubs do not declare the buffer protocol


def _nanoseconds(ticks: int, base: Fraction) -> int:
    return ticks * 1_000_000_000 * base.numerator // base.denominator
