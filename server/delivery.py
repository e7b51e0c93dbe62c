"""The way to one viewer: frames and events go out here, and what is sent and acknowledged is counted."""

from __future__ import annotations

import json
import time
from typing import Any, Protocol

from core.errors import SessionError
from server.hub import Hub
from server.messages import BUSY
from server.pacing import Throttle
from server.packets import Position, StreamPacket
from server.settings import Limits
from server.stream import Counters


class Transport(Protocol):
    """What a session writes to; either call waits until earlier writes have drained."""

    async def binary(self, frame: bytes) -> None:
        """Send a packet that is framed already."""

    async def text(self, message: str) -> None:
        """Send a control message."""

    def offer(self, frame: bytes) -> bool:
        """Send a framed packet now, if earlier writes have drained; whether that was so."""


class Delivery:
    """What one viewer was given, and whether it may be given more.

    Args:
        transport: its connection.
        hub: of its stream.
        counters: of its stream.
        limits: of the server.
        kilobytes_per_second: the most that it wants, or None.

    Attributes:
        counters: where bytes are counted.
        last: newest packet that was given.
        sent: bytes of all packets given.
        held_seconds: time spent waiting for the viewer since it was last up to date.
        full: whether acknowledgements are being waited for.
    """

    def __init__(
        self, transport: Transport, hub: Hub, counters: Counters, limits: Limits, kilobytes_per_second: float | None
    ) -> None:
        self.counters = counters
        self.last: StreamPacket | None = None
        self.sent = 0
        self.held_seconds = 0.0
        self.full = False
        self._transport, self._hub, self._limits = transport, hub, limits
        self._acked = 0
        self._acked_at: float | None = None
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
    def is_throttled(self) -> bool:
        """Whether there is a rate to keep to."""
        return self._throttle.bounded

    def acknowledge(self, received: int, now: float) -> None:
        """The viewer has received that many bytes of packets."""
        self._acked = max(self._acked, min(received, self.sent))
        self._acked_at = now

    def must_wait(self, now: float) -> bool:
        """Whether nothing may be sent yet.

        Raises:
            SessionError: 1013, nothing was acknowledged for too long.
        """
        if now < self.free_at:
            return True
        self.full = self._is_flight_full()
        if not self.full:
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

    def offer(self, frame: bytes, packet: StreamPacket) -> bool:
        """Send a framed packet if it can go out at once; whether it did."""
        if self._is_flight_full() or not self._transport.offer(frame):
            return False
        self.last = packet
        self._account(frame)
        return True

    async def event(self, message: dict[str, Any]) -> None:
        """Send a control message."""
        await self._transport.text(json.dumps(message))

    def _is_flight_full(self) -> bool:
        """Whether more is unacknowledged than a viewer may leave so; one that never acknowledges is not asked."""
        if self._acked_at is None or self.sent - self._acked <= self._limits.flight_bytes:
            return False
        key = self._hub.keyframe
        return self.sent - self._acked > self._limits.flight_bytes + (len(key.data) if key else 0)

    def _account(self, frame: bytes) -> int:
        """Count a frame that was sent; the size of its packet."""
        size = len(frame) - _overhead(len(frame))
        self.sent += size
        self.counters.sent_bytes += size
        return size


def _overhead(frame_bytes: int) -> int:
    """Length of the websocket header of a frame of that total length."""
    return 2 if frame_bytes < 128 else 4 if frame_bytes < (1 << 16) + 4 else 10
