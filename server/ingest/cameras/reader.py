"""Reads a camera's pictures with PyAV on a thread of its own, and its sound where that is wanted."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from functools import partial
from typing import Protocol

import av
import av.container
import av.video.stream

from streamlod.core.camera.grid import period_of
from streamlod.core.data.video.decoding import played_pictures
from streamlod.core.data.video.sound import decoded_sound, sound_of
from streamlod.core.data.video.times import pictures_of
from streamlod.core.data.video.upright import upright, upright_size
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address
from streamlod.server.ingest.cameras.live_decoding import LiveDecoding
from streamlod.server.ingest.cameras.opening import open_source
from streamlod.server.ingest.cameras.picture_size import check_size, max_pixels
from streamlod.server.ingest.cameras.reports import Reports, bytes_of, media_ns_of
from streamlod.server.ingest.cameras.source_thread import SourceThread
from streamlod.server.ingest.sound.listening import Ear
from streamlod.server.ingest.sync.clock import CaptureClock, CaptureTime, ClockSource, Sighting, read_timecode
from streamlod.server.ingest.sync.picture import Picture, one_at_a_time
from streamlod.server.ingest.sync.timeline import Timeline


class Sink(Protocol):
    """Where pictures go. Called from the readers' threads."""

    def put(self, picture: Picture) -> None:
        """A picture has come."""

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        """A camera delivers nothing for now, or no more because its file has `ended`."""


class Reader(SourceThread):
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
        hearing: takes the sound of a live source, if it is wanted.
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
        hearing: Ear | None = None,
    ) -> None:
        super().__init__(f"camera {camera}", address)
        self.camera = camera
        self.clock: CaptureClock | None = None
        self._size, self._fps, self._sink, self._timeline = size, fps, sink, timeline
        self._anchor_ns, self._paced = anchor_ns, paced
        self._hearing = hearing

    def _gone(self, reason: str, *, ended: bool) -> None:
        self._sink.gone(self.camera, reason, ended=ended)

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
            # 0 is not known yet, and pictures of swapped sides may be turned upright, as they will tell
            if width and height and (height, width) != self._size:
                check_size(self.camera, (width, height), self._size)
            self.clock = CaptureClock(self._fps, expects_ntp=self._address.scheme in ("rtsp", "rtsps"))
            self.connections += 1
            if not self._address.is_live:
                self._play(container, stream)
                return
            behind_ns: int | None = None  # of the connection's own times, what they have to be moved by
            for seen, frame in self._frames(container, stream, self.clock):
                if self._stopping.is_set():
                    return
                if isinstance(frame, av.AudioFrame):
                    if self._hearing is not None and seen.media_ns is not None and behind_ns is not None:
                        self._hearing.put(frame, seen.media_ns + behind_ns)
                    continue
                found = self.clock.capture(seen)
                if found is not None:
                    behind_ns = None if seen.media_ns is None else found.capture_ns - seen.media_ns
                    self._deliver(frame, found)

    def _play(self, container: av.container.InputContainer, stream: av.video.stream.VideoStream) -> None:
        """A file, at its pace; one without times at the rig's rate."""
        rate = 1_000_000_000 / period_of(self._fps)
        for since_begin_ns, frame in played_pictures(container, stream, rate):
            found = self._wait(since_begin_ns)
            if self._stopping.is_set() or found is None:
                return
            self._deliver(frame, found)

    def _frames(
        self, container: av.container.InputContainer, stream: av.video.stream.VideoStream, clock: CaptureClock
    ) -> Iterator[tuple[Sighting, av.VideoFrame | av.AudioFrame]]:
        """Pictures as they come, and sound where that is wanted."""
        sound = None if self._hearing is None else sound_of(container)
        if self._hearing is not None and sound is None:
            self._hearing.gone("its source holds no sound")
        reports = Reports(clock)
        decoding = LiveDecoding(self.camera, stream, lambda fault: self._gone(fault, ended=False))
        for packet in container.demux([stream] if sound is None else [stream, sound]):
            arrival = self._timeline.now_ns()
            if packet.stream is sound:
                for frame in decoded_sound(packet):
                    yield Sighting(arrival, media_ns_of(frame)), frame
                continue
            reports.note(packet)
            for picture in decoding.pictures(packet):
                yield Sighting(arrival, media_ns_of(picture), timecode_ns=_timecode(picture, self._fps)), picture

    def _wait(self, since_begin_ns: int) -> CaptureTime | None:
        """The capture time of a file's picture, when that time has come; None if stopped meanwhile."""
        capture = self._anchor_ns + since_begin_ns
        if self._paced and self._stopping.wait(max(0.0, (capture - self._timeline.now_ns()) / 1e9)):
            return None
        return CaptureTime(capture, ClockSource.FILE, 0)

    def _deliver(self, frame: av.VideoFrame, found: CaptureTime) -> None:
        check_size(self.camera, upright_size(frame), self._size)
        load = one_at_a_time(partial(upright, frame))
        self._sink.put(Picture(self.camera, found.capture_ns, found.source, found.error_ns, load))


def _timecode(frame: av.VideoFrame, fps: float) -> int | None:
    data = frame.side_data.get("S12M_TIMECODE")
    if data is None:
        return None
    raw = bytes_of(data)
    if len(raw) < 8:
        return None
    return read_timecode(struct.unpack_from("<I", raw, 4)[0], 1_000_000_000 / period_of(fps))
