"""A rig in operation: readers fill the synchroniser, and the newest complete instant is given out.

When training is slower than filming, older instants that are waiting are dropped and counted, so that latency stays
below one period plus the synchroniser's deadline.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from streamlod.codec.mp4.sound import SoundPiece
from streamlod.core.camera.grid import period_of
from streamlod.core.errors import InputError
from streamlod.server.ingest.board_sight import BoardSight
from streamlod.server.ingest.cameras.definition import RigDefinition
from streamlod.server.ingest.cameras.reader import Reader
from streamlod.server.ingest.cameras.readers import readers
from streamlod.server.ingest.cameras.rig_sound import RigSound
from streamlod.server.ingest.cameras.source_thread import ENDED
from streamlod.server.ingest.findings import Findings
from streamlod.server.ingest.holders import Holders
from streamlod.server.ingest.sound.listening import CameraEar
from streamlod.server.ingest.statistics import CameraStatistics, Statistics
from streamlod.server.ingest.sync.clock import PLAUSIBLE_NS, ClockSource
from streamlod.server.ingest.sync.pace import Pace
from streamlod.server.ingest.sync.picture import Picture
from streamlod.server.ingest.sync.synchroniser import Instant, Synchroniser
from streamlod.server.ingest.sync.timeline import Timeline

_LOG = logging.getLogger(__name__)
_LEAD = 4  # periods that the reader of an unpaced file may be ahead of the others; also instants that may wait
_JOIN_SECONDS = 0.5
_FOREVER_NS = 2**62
_SENDERS_CLOCKS = (ClockSource.NTP, ClockSource.STATED, ClockSource.TIMECODE)
_CLOCK_LOST = f"its clock is {PLAUSIBLE_NS // 10**9} s off or more, or silent; its pictures are timed by their arrival"


@dataclass(slots=True)
class _Last:
    """The latest state of one camera."""

    source: ClockSource | None = None
    error_ns: int = 0
    fault: str = ""
    ended: bool = False
    put: int = 0
    newest_ns: int | None = None
    pace: Pace = field(default_factory=Pace)


class Rig:
    """A rig in operation: its readers fill the synchroniser, `instants` gives out what is ready.

    Args:
        definition: of the rig.
        chosen: names of the cameras to read.
        give_sound, listeners: see `RigSound`.

    Attributes:
        fps: instants a second.
        sound: of its sources.
        pushed: (width, height) of each camera that capture nodes push, by name.
        holders: who pushes those.
        findings: what was found in the cameras' pictures.
        waiting: whether training waits; set by the consumer of `instants`.
    """

    def __init__(
        self,
        definition: RigDefinition,
        chosen: Sequence[str],
        give_sound: Callable[[SoundPiece], None] | None = None,
        listeners: Mapping[str, CameraEar] = MappingProxyType({}),
    ) -> None:
        self.fps, self._paced = definition.fps, definition.realtime
        self._names = tuple(chosen)
        self._offsets_ns = definition.offsets_ns
        self._sizes = {camera.name: (camera.width, camera.height) for camera in definition.cameras}
        self._epoch_ns: int | None = None
        self._timeline = Timeline()
        self._change = threading.Condition()
        self._stopped = self.waiting = False
        self._last = {name: _Last() for name in self._names}
        self._instants: deque[Instant] = deque()
        self._virtual_ns = 0
        self.holders, self.findings = Holders(self._names), Findings(self._names)
        self._delivered = self._stale = self._latency_ns = 0
        quorum = self._quorum = max(1, definition.quorum - (len(definition.cameras) - len(self._names)))
        self._synchroniser = Synchroniser(
            self._names,
            definition.fps,
            quorum=quorum,
            # of unpaced files: when no reader may be so far behind any more
            deadline_ns=None if self._paced else round((_LEAD + 2) * period_of(definition.fps)),
            lost_ns=1_000_000_000 if self._paced else _FOREVER_NS,
        )
        self.pushed = {
            camera.name: self._sizes[camera.name]
            for camera, address in zip(definition.cameras, definition.addresses, strict=True)
            if camera.name in self._last and address.scheme == "push"
        }
        self.sound = RigSound(definition, self._names, self._timeline, give_sound, listeners, self._wait_for_pictures)
        self._readers = readers(definition, self._names, self, self._timeline, self.sound)

    @property
    def now_ns(self) -> int:
        """The present, nanoseconds since 1970 at monotonic pace; arrivals are measured with it."""
        return self._timeline.now_ns()

    def start(self) -> None:
        """Begin to read all cameras."""
        for reader in self._readers:
            reader.start()

    def stop(self) -> None:
        """End reading; `instants` ends too."""
        with self._change:
            self._stopped = True
            self._change.notify_all()
        for reader in self._readers:
            reader.stop()
        end = time.monotonic() + _JOIN_SECONDS
        for reader in self._readers:
            reader.join(max(0.0, end - time.monotonic()))

    def put(self, picture: Picture) -> None:
        """Take a picture, from any thread; waits while an unpaced file is ahead of the others."""
        if offset_ns := self._offsets_ns.get(picture.camera, 0):
            picture = replace(picture, capture_ns=picture.capture_ns + offset_ns)
        with self._change:
            last = self._last[picture.camera]
            if picture.source is ClockSource.ARRIVAL and last.source in _SENDERS_CLOCKS:
                _LOG.warning("camera %s: %s", picture.camera, _CLOCK_LOST)
            last.source, last.error_ns = picture.source, picture.error_ns
            last.put += 1
            last.pace.note(self.now_ns)
            last.newest_ns = picture.capture_ns
            if not self._paced:
                self._change.notify_all()  # others may have waited for this camera
                self._change.wait_for(lambda: self._stopped or self._has_room(picture.capture_ns))
            if self._stopped:
                return
            self._virtual_ns = max(self._virtual_ns, picture.capture_ns)
            self._queue(self._synchroniser.push(picture, self._clock_ns()))
            last.fault = ""

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        """A camera delivers nothing for now, or for good."""
        self.holders.leave(camera)
        with self._change:
            last = self._last[camera]
            if reason != last.fault and not self._stopped:
                _LOG.warning("camera %s: %s", camera, reason)
            last.fault, last.ended = reason, ended
            self._queue(self._synchroniser.leave(camera, self._clock_ns()))
            if self._is_over():
                self._queue(self._synchroniser.finish(self._clock_ns()))
            self._change.notify_all()

    def instants(self) -> Iterator[Instant]:
        """The newest instant each time, waiting for one; ends when all sources have ended, or by `stop`."""
        while True:
            with self._change:
                while not self._instants and not self._stopped and not self._is_over():
                    self._change.wait(self._seconds_to_deadline())
                    if self._paced:
                        self._queue(self._synchroniser.poll(self._clock_ns()))
                if self._stopped or not self._instants:
                    return
                instant = self._instants.popleft()
                self._change.notify_all()  # a reader of an unpaced file may wait for room
            yield instant

    def note_delivery(self, instant: Instant) -> int:
        """Count an instant that is given to training now; returns its latency in nanoseconds.

        It is that of its oldest picture: the instant's own time is a place on the grid, up to half a period away.
        """
        taken_ns = min((one.capture_ns for one in instant.pictures if one is not None), default=instant.capture_ns)
        with self._change:
            self._delivered += 1
            self._latency_ns = max(0, self._timeline.now_ns() - taken_ns)  # a sender's clock may be ahead
            return self._latency_ns

    def note_stale(self) -> None:
        """Count an instant that was given out but not used, because there is a newer one."""
        with self._change:
            self._stale += 1

    def sight(self, camera: str) -> BoardSight | None:
        """The camera's sight of the board, if one is looked for; a rig that trains looks for none."""
        return None

    def complaint(self, camera: str) -> str:
        """A sentence for who films, where the camera's times, place or name are wrong; else empty."""
        with self._change:
            if (wrong := self._synchroniser.time_faults()[camera]) is not None:
                return f"its {wrong.words}: reload this page; until then its pictures are left out"
        return self.findings.complaint(camera)

    def genlock_epoch_ns(self, number: int) -> int:
        """When frame number 0 of a genlocked rig was taken; the first number asked about came just now."""
        with self._change:
            if self._epoch_ns is None:
                self._epoch_ns = self._timeline.now_ns() - round(number * period_of(self.fps))
            return self._epoch_ns

    def failure(self) -> InputError | None:
        """Why a rig of files has given out nothing, if a file is at fault."""
        with self._change:
            faults = {name: last.fault for name, last in self._last.items() if last.ended and last.fault != ENDED}
            if self._stopped or self._delivered or not self._is_over() or not faults:
                return None
            name, fault = next(iter(faults.items()))
            return InputError(f"camera {name}", f"{fault}; no instant has as many cameras as it needs")

    def statistics(self) -> Statistics:
        """A snapshot."""
        cameras_read = [reader for reader in self._readers if isinstance(reader, Reader)]
        clocks = {reader.camera: (reader.clock, reader.connections) for reader in cameras_read}
        claims = self.holders.claims()
        sound = self.sound.fault()
        with self._change:
            now = self._clock_ns()
            states, counts = self._synchroniser.states(now), self._synchroniser.counts()
            silences, time_faults = self._synchroniser.silences_ns(now), self._synchroniser.time_faults()
            cameras = {}
            for name, last in self._last.items():
                clock, connections = clocks.get(name, (None, claims[name]))
                found = self.findings.of(name)
                drift = 0.0 if clock is None else clock.drift_ppm
                cameras[name] = CameraStatistics(
                    states[name],
                    last.source,
                    last.error_ns,
                    drift,
                    counts[name],
                    connections,
                    last.fault,
                    found.refused,
                    found.shift,
                    found.knocked,
                    silences[name],
                    time_faults[name],
                    self._sizes[name],
                    last.pace.rate,
                ).judged(self.findings.complaint(name), self.fps if self._paced else None)
            return Statistics(
                self._synchroniser.is_degraded(now),
                self.waiting,
                self._delivered,
                self._stale,
                self._synchroniser.dropped,
                self._latency_ns,
                self._synchroniser.steps,
                cameras,
                sound,
                self.findings.poses,
            )

    def _wait_for_pictures(self, capture_ns: int) -> None:
        """Sound of an unpaced file does not run ahead of the pictures, nor they of it."""
        with self._change:
            if not self._paced:
                self._change.notify_all()
                lead = _LEAD * period_of(self.fps)
                self._change.wait_for(lambda: self._stopped or self._is_over() or capture_ns <= self._virtual_ns + lead)

    def _queue(self, instants: list[Instant]) -> None:
        self._instants.extend(instants)
        while self._paced and len(self._instants) > 1:  # keep the newest alone, and free older pictures at once
            self._instants.popleft()
            self._stale += 1
        if instants:
            self._change.notify_all()

    def _has_room(self, capture_ns: int) -> bool:
        """Whether an unpaced reader may continue: it must not be far ahead of the others, nor of training."""
        newest = [last.newest_ns for last in self._last.values() if not last.ended]
        known = [ns for ns in newest if ns is not None]
        if len(known) < len(newest) or len(self._instants) > _LEAD:
            return False
        heard = capture_ns if self.sound.hearing is None else self.sound.hearing.reached_ns
        return capture_ns - min(*known, heard, capture_ns) <= _LEAD * period_of(self.fps)

    def _is_over(self) -> bool:
        """Whether no instant can come any more: all files have ended, or too many of them without one picture."""
        delivering = sum(not last.ended or last.put > 0 for last in self._last.values())
        return delivering < self._quorum or all(last.ended for last in self._last.values())

    def _clock_ns(self) -> int:
        """The synchroniser's time; for unpaced files, the capture time."""
        return self._timeline.now_ns() if self._paced else self._virtual_ns

    def _seconds_to_deadline(self) -> float | None:
        due = self._synchroniser.deadline_ns() if self._paced else None
        return None if due is None else max(0.0, (due - self._timeline.now_ns()) / 1e9)
