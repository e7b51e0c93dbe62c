"""The messages of an origin, and what each of them changes in the stream that is pulled from it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from streamlod.core.errors import SessionError
from streamlod.server.edge.origin import is_incarnation
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, stream_packet
from streamlod.server.protocol.presenting import Present, parse_presenting
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import FrameStages, StageTimer

_STATES = {"idle", "starting", "live", "degraded", "ended", "failed"}
_MAX_DETAIL = 4096
_MAX_EPOCH = 2**32 - 1
_MAX_SESSION = 64  # characters
_MAX_CLOCK_AHEAD_NS = 86_400 * 10**9  # a day; a clock that is further away is none


class OtherStreamError(Exception):
    """The origin's stream is not the one that is held.

    Attributes:
        incarnation: of the origin's; None where it told none.
    """

    def __init__(self, told: object) -> None:
        super().__init__("the origin has another stream under this id")
        self.incarnation = told if isinstance(told, str) and is_incarnation(told) else None


class OriginMessages:
    """Changes a stream by what its origin sends; whatever these methods raise ends the pull.

    Args:
        stream: whose packets come.
        origin_name: as viewers are told.

    Attributes:
        breaks: how often the connection to the origin broke.
        clock_ahead_ns: of the origin's clock.
    """

    def __init__(self, stream: Stream, origin_name: str) -> None:
        self._stream, self._origin_name = stream, origin_name
        self.breaks = 0
        self.clock_ahead_ns = 0
        self._coming_epoch = 0  # of the packets that arrive
        self._joining = False  # until the first packet of a connection has been compared with what is held
        self._session = ""  # of ours at the origin

    @property
    def held(self) -> Position | None:
        """Position of the newest packet that the stream has, from which to go on."""
        return self._stream.newest

    def on_welcome(
        self, message: dict[str, Any], sent_ns: int, present: Callable[[dict[str, Any]], None] | None = None
    ) -> None:
        """The origin has taken us; the hello left at Unix time `sent_ns`. `present` asks it to show a view.

        Raises:
            OtherStreamError: packets would not be of the stream that is held.
        """
        if (found := message.get("incarnation")) != self._stream.incarnation:
            raise OtherStreamError(found)
        now_ns, told_ns = time.time_ns(), message.get("server_time_ns")
        if type(told_ns) is int and abs(told_ns - now_ns) < _MAX_CLOCK_AHEAD_NS:
            self.clock_ahead_ns = told_ns - (sent_ns + now_ns) // 2
        self._joining = True
        self._session = str(message.get("session"))[:_MAX_SESSION]
        self._stream.together.forward = None if present is None else lambda shown: present(shown.to_json())
        self._on_right(message.get("together") if present else None)
        self._on_state(message)

    def on_event(self, message: dict[str, Any]) -> None:
        """An event, in order with the packets."""
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
        """A packet.

        Raises:
            BitstreamError, ValueError: it cannot be used, or does not follow the newest one.
        """
        stream = self._stream
        packet = stream_packet(stream.sequence, self._coming_epoch, data)
        joining, self._joining = self._joining, False
        if any(held.data == data for held in stream.hub.window.read(packet.position, packet.position)):
            return
        before, timer = stream.newest, StageTimer()

        decoded = await stream.hub.decode(packet)
        timer.end("decode")
        if before is None or packet.position.epoch != before.epoch:
            stream.tell(event("epoch", epoch=packet.position.epoch))
        stream.hub.send(decoded, stream.window_message())
        timer.end("send")
        if stream.traces.listeners:
            position = packet.position
            stream.traces.tell(FrameStages(stream.id, stream.incarnation, position, (), timer.stages, is_origin=False))
        if joining and before is not None:  # packets are missing in between; a keyframe begins anew
            stream.bus.skip()
        retained = stream.bus.window.newest  # behind the hub's where a group of pictures was dropped
        stream.publish(packet if retained is None else replace(packet, sequence=retained.sequence + 1))

    def on_sound(self, data: bytes) -> None:
        """A piece of live sound.

        Raises:
            BitstreamError: it is none.
        """
        self._stream.hear(data)

    def on_break(self, reason: str) -> None:
        """The connection broke, or could not be opened; another attempt follows."""
        self.breaks += 1
        self._stream.together.permit(False)
        self._stream.together.relay(None, Present(None, None))
        lost = f"the connection to {self._origin_name} is lost ({reason}); it is being restored"
        self._stream.enter("degraded", lost[:_MAX_DETAIL])

    def _on_right(self, told: object) -> None:
        if isinstance(told, dict) and isinstance(may := told.get("may_present"), bool):
            self._stream.together.permit(may)

    def _on_presenter(self, message: dict[str, Any]) -> None:
        self._on_right(message)
        by = message.get("by")
        shown = {"type": "present", "view": message.get("view"), "at": message.get("at")}
        if by is None or (isinstance(by, str) and len(by) <= _MAX_SESSION):
            with contextlib.suppress(SessionError):  # a view that cannot be followed
                found = parse_presenting(shown if by else {"type": "present"})
                if isinstance(found, Present):
                    self._stream.together.relay(by, found, is_ours=by == self._session)

    def _on_progress(self, message: dict[str, Any]) -> None:
        stream = self._stream
        fraction, loss, text = message.get("fraction"), message.get("loss"), message.get("text")
        if fraction is None:
            stream.progress = None
            stream.tell(event("progress"))
        elif isinstance(fraction, int | float) and isinstance(loss, int | float | None) and isinstance(text, str):
            stream.progress = {"fraction": fraction, "loss": loss, "text": text[:_MAX_DETAIL]}
            stream.tell(event("progress", **stream.progress))

    def _on_state(self, message: dict[str, Any]) -> None:
        state, detail = message.get("state"), message.get("detail")
        if isinstance(state, str) and state in _STATES and isinstance(detail, str):
            self._stream.enter(state, detail[:_MAX_DETAIL])
