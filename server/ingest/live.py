"""The live data set: readers and synchroniser as an iterator of frame sets that training reads.

When training is slower than filming, the newest instant wins: older ones that wait are dropped and counted, so that
latency stays below one period plus the synchroniser's deadline. Pixels are converted only for instants that are used.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from core.arrays import UInt8
from core.camera import Camera
from core.data.lens import Development, development
from core.errors import InputError
from core.frames import FrameSet, PointCloud
from server.ingest.clock import ClockSource
from server.ingest.definition import RigDefinition, read_definition
from server.ingest.grid import period_of
from server.ingest.picture import Picture
from server.ingest.push import Intake
from server.ingest.relay import listening
from server.ingest.sources import Reader
from server.ingest.synchroniser import CameraState, Counts, Slot, Synchroniser
from server.ingest.timeline import Timeline

_LOG = logging.getLogger(__name__)
_LEAD = 4  # pictures that the reader of an unpaced file may be ahead of the others
_JOIN_SECONDS = 0.5
_FOREVER_NS = 2**62
_FILE_DELAY_NS = 300_000_000  # until files are open on all threads


@dataclass(frozen=True, slots=True)
class CameraStatistics:
    """How one camera does: state, what its time rests on, drift of its clock, counters, connections, last fault."""

    state: CameraState
    clock_source: ClockSource | None
    error_ns: int
    drift_ppm: float
    counts: Counts
    connections: int
    fault: str


@dataclass(frozen=True, slots=True)
class Statistics:
    """How the rig does.

    Attributes:
        degraded: whether some camera is lost.
        delivered: instants handed to training.
        dropped_stale: instants that training was too slow for.
        dropped_incomplete: instants with fewer cameras than the policy asks for.
        latency_ns: from capture to delivery, of the newest instant delivered.
        clock_steps: times that the cameras' common clock was stepped.
        cameras: by name.
    """

    degraded: bool
    delivered: int
    dropped_stale: int
    dropped_incomplete: int
    latency_ns: int
    clock_steps: int
    cameras: dict[str, CameraStatistics]


@dataclass(slots=True)
class _Last:
    """The latest of one camera."""

    source: ClockSource | None = None
    error_ns: int = 0
    drift_ppm: float = 0.0
    connections: int = 0
    fault: str = ""
    ended: bool = False
    put: int = 0


class Rig:
    """A rig in operation: its readers fill the synchroniser, `slots` gives out what is ready.

    Args:
        definition: of the rig.
        chosen: names of the cameras to read.
    """

    def __init__(self, definition: RigDefinition, chosen: Sequence[str]) -> None:
        self._fps, self._paced = definition.fps, definition.realtime
        self._names = tuple(chosen)
        self._epoch_ns: int | None = None
        self._timeline = Timeline()
        self._change = threading.Condition()
        self._stopped = False
        self._last = {name: _Last() for name in self._names}
        self._slots: deque[Slot] = deque()
        self._virtual_ns = 0
        self._delivered = self._stale = self._latency_ns = 0
        quorum = max(1, definition.quorum - (len(definition.cameras) - len(self._names)))
        self._synchroniser = Synchroniser(
            self._names,
            definition.fps,
            quorum=quorum,
            deadline_ns=None if self._paced else _FOREVER_NS,
            lost_ns=1_000_000_000 if self._paced else _FOREVER_NS,
        )
        self._pushed = {
            camera.name: (camera.width, camera.height)
            for camera, address in zip(definition.cameras, definition.addresses, strict=True)
            if camera.name in self._last and address.scheme == "push"
        }
        anchor = self._timeline.now_ns() + _FILE_DELAY_NS
        self._readers = [
            Reader(
                camera.name,
                address,
                (camera.width, camera.height),
                definition.fps,
                self,
                self._timeline,
                anchor_ns=anchor,
                paced=self._paced,
            )
            for camera, address in zip(definition.cameras, definition.addresses, strict=True)
            if camera.name in self._last and camera.name not in self._pushed
        ]

    @property
    def now_ns(self) -> int:
        """The present, nanoseconds since 1970 at monotonic pace; arrivals are measured with it."""
        return self._timeline.now_ns()

    def start(self) -> None:
        """Begin to read all cameras."""
        for reader in self._readers:
            reader.start()

    def stop(self) -> None:
        """End reading; `slots` ends too."""
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
        with self._change:
            last = self._last[picture.camera]
            last.source, last.error_ns = picture.source, picture.error_ns
            last.put += 1
            if not self._paced:
                self._change.wait_for(lambda: self._stopped or self._has_room(last))
            if self._stopped:
                return
            self._virtual_ns = max(self._virtual_ns, picture.capture_ns)
            self._queue(self._synchroniser.push(picture, self._clock_ns()))
            last.fault = ""

    def gone(self, camera: str, reason: str, *, ended: bool) -> None:
        """A camera delivers nothing for now, or for good."""
        with self._change:
            last = self._last[camera]
            if reason != last.fault:
                _LOG.warning("camera %s: %s", camera, reason)
            last.fault, last.ended = reason, ended
            self._queue(self._synchroniser.leave(camera, self._clock_ns()))
            if self._is_over():
                self._queue(self._synchroniser.finish(self._clock_ns()))
            self._change.notify_all()

    def slots(self) -> Iterator[Slot]:
        """The newest instant each time, waiting for one; ends when all sources have ended, or by `stop`."""
        while True:
            with self._change:
                while not self._slots and not self._stopped and not self._is_over():
                    self._change.wait(self._seconds_to_deadline())
                    if self._paced:
                        self._queue(self._synchroniser.poll(self._clock_ns()))
                if self._stopped or not self._slots:
                    return
                if self._paced:
                    self._stale += len(self._slots) - 1
                    slot = self._slots.pop()
                    self._slots.clear()
                else:
                    slot = self._slots.popleft()
                    self._change.notify_all()
                self._delivered += 1
                self._latency_ns = self._timeline.now_ns() - slot.capture_ns
            yield slot

    @property
    def fps(self) -> float:
        """Instants a second."""
        return self._fps

    @property
    def pushed(self) -> Mapping[str, tuple[int, int]]:
        """(width, height) of each camera that capture nodes push."""
        return self._pushed

    def genlock_epoch_ns(self, number: int) -> int:
        """When frame number 0 of a genlocked rig was taken; the first number asked about came just now."""
        with self._change:
            if self._epoch_ns is None:
                self._epoch_ns = self._timeline.now_ns() - round(number * period_of(self._fps))
            return self._epoch_ns

    def refuse(self, camera: str, fault: str) -> None:
        """Note that a picture of a camera could not be used."""
        with self._change:
            self._last[camera].fault = fault

    def statistics(self) -> Statistics:
        """A snapshot."""
        clocks = {reader.camera: (reader.clock, reader.connections) for reader in self._readers}
        with self._change:
            now = self._clock_ns()
            states, counts = self._synchroniser.states(now), self._synchroniser.counts()
            cameras = {}
            for name, last in self._last.items():
                clock, connections = clocks.get(name, (None, 0))
                drift = 0.0 if clock is None else clock.drift_ppm
                cameras[name] = CameraStatistics(
                    states[name], last.source, last.error_ns, drift, counts[name], connections, last.fault
                )
            return Statistics(
                self._synchroniser.is_degraded(now),
                self._delivered,
                self._stale,
                self._synchroniser.dropped,
                self._latency_ns,
                self._synchroniser.steps,
                cameras,
            )

    def _queue(self, slots: list[Slot]) -> None:
        self._slots.extend(slots)
        if self._paced and len(self._slots) > 1:  # newest wins, and older pictures are let go at once
            self._stale += len(self._slots) - 1
            newest = self._slots.pop()
            self._slots.clear()
            self._slots.append(newest)
        if slots:
            self._change.notify_all()

    def _has_room(self, last: _Last) -> bool:
        """Whether an unpaced reader may go on: not far ahead of the others, and not of training."""
        behind = min((other.put for other in self._last.values() if not other.ended), default=last.put)
        return last.put - behind <= _LEAD and len(self._slots) <= _LEAD

    def _is_over(self) -> bool:
        return all(last.ended for last in self._last.values())

    def _clock_ns(self) -> int:
        """The synchroniser's time; files that aren't paced carry their own."""
        return self._timeline.now_ns() if self._paced else self._virtual_ns

    def _seconds_to_deadline(self) -> float | None:
        due = self._synchroniser.deadline_ns() if self._paced else None
        return None if due is None else max(0.0, (due - self._timeline.now_ns()) / 1e9)


@dataclass(eq=False)
class LiveDataset:
    """A live rig where a data set is expected: cameras without distortion at the size wanted, and frames as they come.

    Attributes:
        definition: of the rig.
        developments: what makes a raw picture fit the camera, for each camera used.
        push_socket: where to take pictures that the serving process relays, while frames are read; or none.
        cameras: pinholes that match the pictures of `frames`.
    """

    definition: RigDefinition
    developments: tuple[Development, ...]
    push_socket: Path | None = None
    cameras: tuple[Camera, ...] = field(init=False)
    frame_count: None = field(init=False, default=None)  # endless
    _rig: Rig | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.cameras = tuple(plan.camera for plan in self.developments)
        first = self.cameras[0]
        for camera in self.cameras:
            if (camera.width, camera.height) != (first.width, first.height):
                fault = f"gives pictures of {camera.width}x{camera.height}, but {first.name} of "
                raise InputError(
                    f"camera {camera.name}", f"{fault}{first.width}x{first.height}; bring them to one size"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def fps(self) -> float:
        """Instants a second."""
        return self.definition.fps

    @property
    def depth_bounds(self) -> tuple[float, float] | None:
        """Nearest and farthest depth of the scene in world units, if known."""
        return self.definition.depth_bounds

    def points(self) -> PointCloud | None:
        """The points that came with the calibration, or none."""
        return self.definition.points

    def select(self, names: Sequence[str]) -> LiveDataset:
        """The same rig with the cameras `names` only, in that order; others aren't read.

        A quorum shrinks by the cameras left out.

        Raises:
            InputError: a name that does not exist, or given twice.
        """
        plans = {plan.camera.name: plan for plan in self.developments}
        unknown = [name for name in names if name not in plans]
        if unknown:
            raise InputError(self.definition.path, f"has no camera {unknown[0]!r:.80}; it has {', '.join(plans)}")
        if not names or len(set(names)) < len(names):
            raise InputError(self.definition.path, "needs at least one camera selected, and each only once")
        return LiveDataset(self.definition, tuple(plans[name] for name in names), self.push_socket)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[FrameSet]:
        """Instants as they come, numbered from `start` without gaps, `stop` - `start` of them or until the sources end.

        Reading begins with the first one asked for, and ends when the iterator is closed or dropped. `time_ns` always
        increases, by multiples of a period, even when the cameras' clocks are stepped.

        Raises:
            ValueError: negative numbers, or the rig is being read already.
        """
        if start < 0 or (stop is not None and stop < start):
            raise ValueError(f"frames {start} to {stop} do not exist")
        if self._rig is not None:
            raise ValueError("the rig is being read already; close its frames first")
        return self._frames(start, stop)

    def close(self) -> None:
        """End the frames that are being read, from any thread."""
        if (rig := self._rig) is not None:
            rig.stop()

    def statistics(self) -> Statistics | None:
        """How cameras and delivery do; None while nothing is read."""
        rig = self._rig
        return None if rig is None else rig.statistics()

    @property
    def rig(self) -> Rig | None:
        """The rig in operation, which takes pushed pictures; None while nothing is read."""
        return self._rig

    def _frames(self, start: int, stop: int | None) -> Iterator[FrameSet]:
        index = start
        if stop is not None and index >= stop:
            return
        rig = self._rig = Rig(self.definition, self.names)
        with ExitStack() as stack:
            stack.callback(self._release)
            stack.callback(rig.stop)
            pool = stack.enter_context(ThreadPoolExecutor(min(len(self.cameras), os.cpu_count() or 1), "develop"))
            if self.push_socket is not None and rig.pushed:
                stack.enter_context(listening(self.push_socket, lambda: Intake(rig)))
            rig.start()
            first: Slot | None = None
            for slot in rig.slots():
                first = slot if first is None else first
                time_ns = first.capture_ns + round((slot.number - first.number) * period_of(self.fps))
                frame = self._develop(rig, slot, index, time_ns, pool)
                if frame is None:
                    continue
                yield frame
                index += 1
                if index == stop:
                    return

    def _develop(self, rig: Rig, slot: Slot, index: int, time_ns: int, pool: ThreadPoolExecutor) -> FrameSet | None:
        height, width = self.cameras[0].height, self.cameras[0].width
        images = np.zeros((len(self.cameras), height, width, 3), np.uint8)

        def one(plan: Development, picture: Picture | None, into: UInt8) -> bool:
            if picture is None:
                return False
            try:
                into[:] = plan(picture.load())
            except InputError as error:
                rig.refuse(picture.camera, error.fault)
                return False
            return True

        present = np.array(list(pool.map(one, self.developments, slot.pictures, images)), np.bool_)
        return FrameSet(index, time_ns, images, present) if present.any() else None

    def _release(self) -> None:
        self._rig = None


def open_live(path: Path, *, downscale: float = 1, push_socket: Path | None = None) -> LiveDataset:
    """The rig that the file `path` describes, its pictures made smaller by `downscale`.

    Pushed pictures come through a `RelayedIntake` to `push_socket`, or from an `Intake(dataset.rig)` in this process.

    Raises:
        InputError: see `read_definition`; a distortion that cannot be undone, or a downscale below 1.
    """
    definition = read_definition(path)
    if not 1 <= downscale <= 64:
        raise InputError("downscale", f"must lie between 1 and 64, not {downscale}")
    return LiveDataset(definition, tuple(development(camera, downscale) for camera in definition.cameras), push_socket)
