"""One stream as its viewers see it: its live end, its retained packets, its published state.

Where its packets come from is a subclass's business: a worker process (`WorkerStream`), or another server.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from streamlod.core.errors import StorageError
from streamlod.core.masking import masked
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, StreamPacket, text_frame
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.hub import Hub
from streamlod.server.stream.sound_track import SoundTrack
from streamlod.server.stream.together import Together
from streamlod.server.stream.traces import Traces

_LOG = logging.getLogger(__name__)
_HUB_BYTES = 8_000_000  # packets that viewers may lag behind within; seeking reads the bus
_WINDOW_SECONDS = 1.0  # from one window event to the next
Source = Literal["cameras", "data", "recording"]


class Stream:
    """The common part of streams of all sources.

    Args:
        name: its id in addresses.
        incarnation: names its packets for good.
        settings: of the server.
        bus: its retained packets; those in memory alone by default.
        feed: where its states are told.
        traces: where the stages of its frames are told.

    Attributes:
        source, loop, created_at: as in STREAM of docs/protocol.md.
        deleted: its viewers are told that it is over.
        replaced: its viewers are told to connect again.
        push_socket: where its worker takes pictures that capture nodes push, or None.
        played_file: the recording that it plays, or None.
        file_sound: what is told of the sound of the file that it plays, or of its origin; None without.
        sound_track: its live sound.
        worker_node: address of the cluster's node that its worker runs on; empty where it runs on this machine, or not.
        is_paused: whether it plays a file that nobody watches, and so makes no packets for now.
        sequence: serial number of the next packet.
        camera_pictures: a small JPEG file of what each camera saw last, where the server shows that.
    """

    source: Source = "data"
    loop = False
    created_at = datetime.fromtimestamp(0, UTC)
    push_socket: Path | None = None
    played_file: Path | None = None
    file_sound: dict[str, Any] | None = None
    worker_node = ""
    is_paused = False

    def __init__(
        self,
        name: str,
        incarnation: str,
        settings: Settings,
        bus: Bus | None = None,
        feed: Feed | None = None,
        traces: Traces | None = None,
    ) -> None:
        self.id, self.incarnation = name, incarnation
        self.feed = feed or Feed()
        self.traces = traces or Traces()
        self.bus = bus or Bus(settings.retention.memory_bytes)
        self.sound_track = SoundTrack(self.bus.recording if self.bus.keeps else None)
        self.counters = Counters()
        self.hub = Hub(_HUB_BYTES, self.counters, settings.limits.decoder)
        self.together = Together(settings.together)
        self.viewers = self.thin_viewers = 0
        self.state, self.detail = "idle", ""
        self.progress: dict[str, Any] | None = None
        self.report: dict[str, Any] | None = None
        self.ingest: dict[str, Any] | None = None  # figures of live cameras
        self.camera_pictures: dict[str, bytes] = {}
        self.deleted = self.replaced = False
        self.live_at = 0.0  # monotonic time of the newest packet
        self.sequence = 0
        self._windowed_at = 0.0
        self._events: list[asyncio.Queue[dict[str, Any]]] = []

    async def close(self) -> None:
        """Take no more packets, because the server ends."""

    def join(self) -> None:
        """A viewer has come."""
        self.viewers += 1
        self.counters.joins += 1

    def leave(self) -> None:
        """A viewer has gone."""
        self.viewers -= 1

    @property
    def is_ready(self) -> bool:
        """Whether it delivers, or has delivered all there is."""
        return self.state in {"live", "ended"}

    @property
    def is_over(self) -> bool:
        """Whether nothing new can come of it."""
        return self.deleted or self.replaced

    @property
    def restarts(self) -> int:
        """How often what delivers packets had to be started again."""
        return 0

    @property
    def newest(self) -> Position | None:
        """The live edge."""
        return self.hub.newest.position if self.hub.newest else None

    @property
    def levels(self) -> int | None:
        """Levels of the scene."""
        return self.hub.newest.info.level_mask.bit_length() if self.hub.newest else None

    @property
    def sound(self) -> dict[str, Any] | None:
        """Facts of its sound, as in docs/protocol.md; None without."""
        return self.file_sound or self.sound_track.facts

    @property
    def window(self) -> dict[str, Any] | None:
        """Oldest and newest position, and when the newest was filmed, as in docs/protocol.md."""
        oldest, newest = self.bus.oldest, self.hub.newest
        if oldest is None or newest is None:
            return None
        times = {"newest_time_ns": newest.info.time_ns}
        return {"oldest": oldest.to_json(), "newest": newest.position.to_json(), **times}

    def now_ns(self) -> int:
        """Unix time of the clock that live cameras' packets carry."""
        return time.time_ns()

    def listen(self) -> asyncio.Queue[dict[str, Any]]:
        """A queue of this stream's events; give it back to `unlisten`."""
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue(64)
        self._events.append(queue)
        return queue

    def unlisten(self, queue: asyncio.Queue[dict[str, Any]]) -> None:
        """No more events into `queue`."""
        self._events.remove(queue)

    def hear(self, data: bytes) -> None:
        """Take a piece of live sound; viewers are told when there is some at last."""
        before = self.sound
        self.sound_track.add(data)
        self._tell_sound(before)

    def _tell_sound(self, before: dict[str, Any] | None) -> None:
        """Tell viewers that there is sound, if there was none `before`."""
        if before is None and self.sound is not None:
            self.tell(event("sound", **self.sound))

    def publish(self, packet: StreamPacket) -> None:
        """Retain the packet that the hub has just accepted."""
        self.bus.publish(packet)
        self.sequence += 1
        self.counters.packets += 1
        self.counters.packet_bytes += len(packet.data)
        self.live_at = time.monotonic()

    def window_message(self) -> bytes:
        """A framed window event, at most once a second, otherwise nothing."""
        now = time.monotonic()
        if now - self._windowed_at < _WINDOW_SECONDS or (window := self.window) is None:
            return b""
        self._windowed_at = now
        return text_frame(json.dumps(event("window", **window)))

    def enter(self, state: str, detail: str = "") -> None:
        """Be in a state of docs/protocol.md, for a reason in `detail`; viewers are told if it is another one."""
        if (state, detail) != (self.state, self.detail):
            self.state, self.detail = state, detail
            if state in {"idle", "ended", "failed"}:
                self.camera_pictures = {}
            self.tell(event("state", state=state, detail=masked(detail)))
            self.feed.tell("stream.state", self.id, state=state, detail=masked(detail))

    def tell(self, message: dict[str, Any]) -> None:
        """Send viewers an event."""
        for queue in self._events:
            if queue.full():  # a viewer that reads nothing; drop its oldest event
                queue.get_nowait()
            queue.put_nowait(message)
        self.hub.wake()

    def note(self, **changes: Any) -> None:
        """Remember fields of `StoredStream` that have changed, as far as the disk takes it."""
        if self.bus.recording is None:
            return
        try:
            self.bus.recording.note(**changes)
        except StorageError as error:
            _LOG.warning("stream %s: %s", self.id, error)
