"""The way to one viewer: frames and events go out here, and what is sent and acknowledged is counted."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any, Protocol

from core.errors import SessionError
from server.protocol.messages import BUSY
from server.protocol.packets import Position, StreamPacket, payload_bytes
from server.settings import Limits
from server.stream.broadcast import Lane
from server.stream.counters import Counters
from server.stream.hub import Hub
from server.viewer.pacing import Throttle

_ACK_SECONDS = 1.0  # that a viewer may take to acknowledge


class Transport(Protocol):
    """What a session writes to; the first two calls wait until earlier writes have drained."""

    async def binary(self, frame: bytes) -> None:
        """Send a packet that is framed already."""

    async def text(self, message: str) -> None:
        """Send a control message."""

    def post(self, frame: bytes) -> None:
        """Send a whole frame at once, while the way is clear."""

    @property
    def is_clear(self) -> bool:
        """Whether earlier writes have drained."""

    def on_blocked(self, call: Callable[[], None]) -> None:
        """Have `call` called whenever the way is clear no more."""


class Delivery:
    """What one viewer was given, and whether it may be given more.

    Args:
        transport: its connection.
        hub: of its stream.
        counters: of its stream.
        limits: of the server.
        kilobytes_per_second: the most that it wants, or None.
        rouse: called when the lane has to be closed.

    Attributes:
        counters: where bytes are counted.
        lane: the short way, open while the viewer is up to date.
        last: newest packet that was given while the lane was closed.
        held_seconds: time spent waiting for the viewer since it was last up to date.
    """

    def __init__(
        self,
        transport: Transport,
        hub: Hub,
        counters: Counters,
        limits: Limits,
        kilobytes_per_second: float | None,
        rouse: Callable[[], None],
    ) -> None:
        self.counters = counters
        self.last: StreamPacket | None = None
        self.lane = Lane(transport.post, rouse)
        self.held_seconds = 0.0
        self._transport, self._hub, self._limits = transport, hub, limits
        self._acked = 0
        self._acked_at: float | None = None
        self._mark: int | None = None  # a number of bytes that had been sent at that time, and not all acknowledged
        self._mark_at = 0.0
        self.limit_rate(kilobytes_per_second)

    def limit_rate(self, kilobytes_per_second: float | None) -> None:
        """Send no more than that, or as much as the connection takes."""
        self._throttle = Throttle(None if kilobytes_per_second is None else kilobytes_per_second * 1000)
        self.free_at = 0.0  # monotonic time before which the rate would be exceeded

    @property
    def position(self) -> Position | None:
        """Where the viewer stands."""
        return self.last.position if self.last else None

    @property
    def can_post(self) -> bool:
        """Whether packets may take the lane."""
        return self._transport.is_clear and not self._throttle.bounded and not self.is_full

    @property
    def is_full(self) -> bool:
        """Whether acknowledgements have to come first; a viewer that never sends any is not asked."""
        return self.lane.sent > self.lane.ceiling

    def acknowledge(self, received: int, now: float) -> None:
        """The viewer has received that many bytes of packets.

        What it may leave unacknowledged is bounded, and little if its packets take long: they wait somewhere between.
        """
        lane = self.lane
        self._acked, self._acked_at = max(self._acked, min(received, lane.sent)), now
        late = self._mark is not None and now - self._mark_at > _ACK_SECONDS + 2 * self._limits.viewer_lag_seconds
        if self._mark is None or self._acked >= self._mark:
            self._mark, self._mark_at = lane.sent if lane.sent > self._acked else None, now
        key = self._hub.keyframe
        allowed = self._limits.flight_bytes + (len(key.data) if key else 0)
        lane.ceiling = self._acked + (0 if late else allowed)

    def must_wait(self, now: float) -> bool:
        """Whether nothing may be sent yet.

        Raises:
            SessionError: 1013, nothing was acknowledged for too long.
        """
        if now < self.free_at:
            return True
        if not self.is_full:
            return False
        if self._acked_at is not None and now - self._acked_at > self._limits.stuck_seconds:
            raise SessionError(BUSY, f"nothing was acknowledged for {self._limits.stuck_seconds:g} s")
        return True

    async def frame(self, frame: bytes, packet: StreamPacket | None = None) -> None:
        """Send a framed packet, as soon as the connection takes it; `packet` is what the viewer holds then."""
        self.last = packet or self.last
        begin = time.monotonic()
        await self._transport.binary(frame)
        now = time.monotonic()
        self.held_seconds += now - begin
        self.free_at = now + self._throttle.spend(self._account(frame), now)

    async def trickle(self, packet: StreamPacket, levels: int, interval_seconds: float) -> None:
        """Send a large packet as one message in pieces, one an interval: the picture goes on until it is complete."""
        for number, frame in enumerate(packet.pieces(levels)):
            if number:
                await asyncio.sleep(interval_seconds)
            await self.frame(frame)
        self.last = packet

    async def event(self, message: dict[str, Any]) -> None:
        """Send a control message."""
        await self._transport.text(json.dumps(message))

    def _account(self, frame: bytes) -> int:
        """Count a frame that was sent; the size of its packet."""
        size = payload_bytes(frame)
        self.lane.sent += size
        self.counters.sent_bytes += size
        return size
