"""A stream of another server: pulled while somebody watches, and served on."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from streamlod.core.errors import BitstreamError, SessionError
from streamlod.server.edge.ending import end
from streamlod.server.edge.origin import OriginStream, is_incarnation
from streamlod.server.edge.supply import Supply, Tell
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, stream_packet
from streamlod.server.protocol.presenting import Present, parse_presenting
from streamlod.server.settings import Settings
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import FrameStages, StageTimer, Traces

_LOG = logging.getLogger(__name__)
_STATES = {"idle", "starting", "live", "degraded", "ended", "failed"}
_MAX_DETAIL = 4096
_MAX_EPOCH = 2**32 - 1
_MAX_SESSION = 64  # characters
_MAX_CLOCK_AHEAD_NS = 86_400 * 10**9  # a day; a clock that is further away is none


class EdgeStream(Stream):
    """Packets are those of the origin, byte for byte, under the origin's positions and incarnation.

    An object serves for one pull. When its packets could differ from the origin's (another incarnation, packets that do
    not fit), or nobody watches any more, it asks to be replaced by a new one, which holds nothing.

    Args:
        described: what the origin says about it.
        supply: its packets.
        settings: of the server.
        feed, traces: where its states and the stages of its frames are told.
        linger_seconds: for which it is pulled after its last viewer has gone.
        replace: called when this object is of no use any more.
        remove: called when the origin has deleted the stream.

    Attributes:
        successor: incarnation that the origin has now instead, where it said so before its list did.
    """

    successor: str | None = None

    def __init__(
        self,
        described: OriginStream,
        supply: Supply,
        settings: Settings,
        feed: Feed,
        traces: Traces,
        linger_seconds: float,
        replace: Callable[[EdgeStream], None],
        remove: Callable[[EdgeStream], None],
    ) -> None:
        super().__init__(described.id, described.incarnation, settings, supply.bus, feed, traces)
        self._supply, self._linger_seconds = supply, linger_seconds
        self._replace, self._remove = replace, remove
        self._task: asyncio.Task[None] | None = None
        self._parting: asyncio.TimerHandle | None = None  # runs while nobody watches a stream that is pulled
        self._breaks = 0
        self._clock_ahead_ns = 0  # of the origin's clock
        self._coming_epoch = 0  # of the packets that arrive
        self._joining = False  # until the first packet of a connection has been compared with what is held
        self._session = ""  # of ours at the origin
        self.together.permit(False)
        self.update(described)

    @property
    def restarts(self) -> int:
        """How often the connection to the origin broke."""
        return self._breaks

    @property
    def is_pulled(self) -> bool:
        """Whether there is a connection to the origin, or one is being opened."""
        return self._task is not None

    @property
    def held(self) -> Position | None:
        """See `supply.PacketTaker`."""
        return self.newest

    def now_ns(self) -> int:
        """Unix time of the origin's clock."""
        return time.time_ns() + self._clock_ahead_ns

    def update(self, described: OriginStream) -> None:
        """Take over what the origin says now; a stream that is pulled hears of its state sooner."""
        self.source, self.loop, self.created_at = described.source, described.loop, described.created_at
        before = self.sound
        self.file_sound = None if described.sound is None else described.sound.model_dump()
        self._tell_sound(before)
        self.report, self.ingest = described.report, described.ingest
        if not self.is_pulled:
            self.progress = described.progress
            self.enter(described.state, described.detail)

    def join(self) -> None:
        """A viewer has come; the first one begins the pull."""
        super().join()
        if self._parting is not None:
            self._parting.cancel()
            self._parting = None
        if self._task is None and not self.is_over:
            self._task = asyncio.create_task(self._pull())

    def leave(self) -> None:
        """A viewer has gone; some time after the last one the pull ends."""
        super().leave()
        if not self.viewers and not self.is_over:
            loop = asyncio.get_running_loop()
            self._parting = loop.call_later(self._linger_seconds, self._replace, self)

    async def close(self) -> None:
        """End the pull."""
        if self._parting is not None:
            self._parting.cancel()
        if self._task is not None:
            await end(self._task)

    def on_welcome(self, message: dict[str, Any], sent_ns: int, present: Tell | None = None) -> None:
        """See `supply.PacketTaker`."""
        found = message.get("incarnation")
        if found != self.incarnation:
            self.successor = found if isinstance(found, str) and is_incarnation(found) else None
            raise _OtherStream("the origin has another stream under this id")
        now_ns, told_ns = time.time_ns(), message.get("server_time_ns")
        if type(told_ns) is int and abs(told_ns - now_ns) < _MAX_CLOCK_AHEAD_NS:
            self._clock_ahead_ns = told_ns - (sent_ns + now_ns) // 2
        self._joining = True
        self._session = str(message.get("session"))[:_MAX_SESSION]
        self.together.forward = None if present is None else lambda shown: present(shown.to_json())
        self._on_right(message.get("together") if present else None)
        self._on_state(message)

    def on_event(self, message: dict[str, Any]) -> None:
        """See `supply.PacketTaker`."""
        match message.get("event"):
            case "epoch" if type(epoch := message.get("epoch")) is int and 0 <= epoch <= _MAX_EPOCH:
                self._coming_epoch = epoch
            case "state":
                self._on_state(message)
            case "progress":
                self._on_progress(message)
            case "skipped":
                self._joining = True
            case "presenter":
                self._on_presenter(message)

    async def on_packet(self, data: bytes) -> None:
        """See `supply.PacketTaker`."""
        packet = stream_packet(self.sequence, self._coming_epoch, data)
        joining, self._joining = self._joining, False
        if self._has(packet.position, data):
            return
        before, timer = self.newest, StageTimer()

        decoded = await self.hub.decode(packet)
        timer.end("decode")
        if before is None or packet.position.epoch != before.epoch:
            self.tell(event("epoch", epoch=packet.position.epoch))
        self.hub.send(decoded, self.window_message())
        timer.end("send")
        if self.traces.listeners:
            position = packet.position
            self.traces.tell(FrameStages(self.id, self.incarnation, position, (), timer.stages, is_origin=False))
        if joining and before is not None:  # packets are missing in between; a keyframe begins anew
            self.bus.skip()
        retained = self.bus.window.newest  # behind the hub's where a group of pictures was dropped
        self.publish(packet if retained is None else replace(packet, sequence=retained.sequence + 1))

    def on_sound(self, data: bytes) -> None:
        """See `supply.PacketTaker`."""
        self.hear(data)

    def on_break(self, reason: str) -> None:
        """See `supply.PacketTaker`."""
        self._breaks += 1
        self.together.permit(False)
        self.together.relay(None, Present(None, None))
        self.enter(
            "degraded",
            f"the connection to {self._supply.origin_name} is lost ({reason}); it is being restored"[:_MAX_DETAIL],
        )

    def _has(self, position: Position, data: bytes) -> bool:
        return self.newest is not None and any(
            packet.data == data for packet in self.hub.window.read(position, position)
        )

    def _on_right(self, told: object) -> None:
        if isinstance(told, dict) and isinstance(may := told.get("may_present"), bool):
            self.together.permit(may)

    def _on_presenter(self, message: dict[str, Any]) -> None:
        self._on_right(message)
        by = message.get("by")
        shown = {"type": "present", "view": message.get("view"), "at": message.get("at")}
        if by is None or (isinstance(by, str) and len(by) <= _MAX_SESSION):
            with contextlib.suppress(SessionError):  # a view that cannot be followed
                found = parse_presenting(shown if by else {"type": "present"})
                if isinstance(found, Present):
                    self.together.relay(by, found, is_ours=by == self._session)

    def _on_progress(self, message: dict[str, Any]) -> None:
        fraction, loss, text = message.get("fraction"), message.get("loss"), message.get("text")
        if fraction is None:
            self.progress = None
            self.tell(event("progress"))
        elif isinstance(fraction, int | float) and isinstance(loss, int | float | None) and isinstance(text, str):
            self.progress = {"fraction": fraction, "loss": loss, "text": text[:_MAX_DETAIL]}
            self.tell(event("progress", **self.progress))

    def _on_state(self, message: dict[str, Any]) -> None:
        state, detail = message.get("state"), message.get("detail")
        if isinstance(state, str) and state in _STATES and isinstance(detail, str):
            self.enter(state, detail[:_MAX_DETAIL])

    async def _pull(self) -> None:
        try:
            await self._supply.pull(self)
        except _OtherStream as error:
            _LOG.info("stream %s: %s", self.id, error)
        except (BitstreamError, ValueError) as error:
            _LOG.warning("stream %s: the origin sent something unusable (%s); it begins anew", self.id, error)
        except Exception:
            _LOG.exception("stream %s: the pull broke; it begins anew", self.id)
        else:
            self._remove(self)
            return
        self._replace(self)


class _OtherStream(Exception):
    """The origin's stream is not the one that is held."""
