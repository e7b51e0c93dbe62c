"""Reads a source of sound that is not part of a live camera's connection: a microphone, a file, or an address."""

from __future__ import annotations

import contextlib

import av.audio.stream
import av.container

from streamlod.core.data.video.sound import decoded_sound, sound_of, timed_sound
from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address
from streamlod.server.ingest.cameras.opening import open_source
from streamlod.server.ingest.cameras.reports import Reports, media_ns_of
from streamlod.server.ingest.cameras.source_thread import SourceThread
from streamlod.server.ingest.sound.listening import Ear
from streamlod.server.ingest.sync.clock import CaptureClock, Sighting
from streamlod.server.ingest.sync.timeline import Timeline

_SECOND_NS = 1_000_000_000


class SoundReader(SourceThread):
    """Reads sound on a thread.

    Args:
        address: of the source.
        fps: of the rig.
        hearing: takes the sound.
        timeline: the rig's.
        anchor_ns: capture time of a file's beginning.
        paced: whether a file is played in real time.
    """

    def __init__(
        self, address: Address, fps: float, hearing: Ear, timeline: Timeline, *, anchor_ns: int, paced: bool
    ) -> None:
        super().__init__(f"sound of {hearing.source}", address)
        self._fps, self._hearing, self._timeline = fps, hearing, timeline
        self._anchor_ns, self._paced = anchor_ns, paced

    def _gone(self, reason: str, *, ended: bool) -> None:
        self._hearing.gone(reason)

    def _read(self) -> None:
        with contextlib.ExitStack() as stack:
            container = open_source(self._address, self._fps, None, stack, self._interruptible)
            stream = sound_of(container)
            if stream is None:
                raise InputError(self._name, "its source holds no sound")
            self.connections += 1
            if self._address.is_live:
                self._listen(container, stream)
            else:
                self._play(container, stream)

    def _play(self, container: av.container.InputContainer, stream: av.audio.stream.AudioStream) -> None:
        capture_ns = self._anchor_ns
        for time, frame in timed_sound(container, stream):
            if time is not None:
                capture_ns = self._anchor_ns + round(time * _SECOND_NS)
            ahead = (capture_ns - self._timeline.now_ns()) / _SECOND_NS if self._paced else 0.0
            if self._stopping.wait(max(0.0, ahead)):
                return
            self._hearing.put(frame, capture_ns)
            capture_ns += frame.samples * _SECOND_NS // max(1, frame.sample_rate)

    def _listen(self, container: av.container.InputContainer, stream: av.audio.stream.AudioStream) -> None:
        is_wall = self._address.scheme == "alsa"  # FFmpeg tells of it by the clock of this machine
        clock = CaptureClock(self._fps, expects_ntp=self._address.scheme in ("rtsp", "rtsps"))
        reports = Reports(clock)
        for packet in container.demux(stream):
            arrival = self._timeline.now_ns()
            reports.note(packet)
            for frame in decoded_sound(packet):
                if self._stopping.is_set():
                    return
                media = media_ns_of(frame)
                lasts = frame.samples * _SECOND_NS // max(1, frame.sample_rate)
                found = clock.capture(Sighting(arrival - lasts, media, stated_ns=media if is_wall else None))
                if found is not None:
                    self._hearing.put(frame, found.capture_ns)
