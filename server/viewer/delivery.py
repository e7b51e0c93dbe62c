"""Sending to one viewer: frames and events go out here; bytes sent and acknowledged are counted (the send window)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any, Protocol

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import SessionError
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import BinaryMessage, Position, StreamPacket
from streamlod.server.settings import Limits
from streamlod.server.stream.broadcast import Receiver
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.hub import Hub
from streamlod.server.viewer.pacing import Throttle

_ACK_SECONDS = 1.0  # that a viewer may take to acknowledge


class Transport(Protocol):
    """A viewer's connection. `binary` and `text` wait until the write buffer has drained."""

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None:
        """Send a packet or picture: at once, or in its pieces with an interval between them."""

    async def text(self, message: str) -> None:
        """Send a control message."""

    def post(self, frame: bytes) -> None:
        """Write a whole websocket frame without waiting; only while `is_clear`."""

    @property
    def is_clear(self) -> bool:
        """Whether the write buffer has drained."""

    def on_blocked(self, call: Callable[[], None]) -> None:
        """Have `call` called whenever the write buffer fills up or the connection ends."""


class Delivery:
    """The account of what was sent to one viewer, and whether more may be sent.

    Args:
        transport: its connection.
        hub: of its stream.
        counters: of its stream.
        limits: of the server.
        kilobytes_per_second: rate limit that the viewer asked for, or None.
        notify: called when the viewer has to leave the broadcast.

    Attributes:
        counters: where bytes are counted.
        receiver: the viewer's place in the broadcast, used while it is up to date.
        last: newest packet that was sent outside the broadcast.
        blocked_seconds: time spent waiting for the viewer since it was last up to date.
    """

    def __init__(
        self,
        transport: Transport,
        hub: Hub,
        counters: Counters,
        limits: Limits,
        kilobytes_per_second: float | None,
        notify: Callable[[], None],
    ) -> None:
        self.counters = counters
        self.last: StreamPacket | None = None
        self.receiver = Receiver(transport.post, notify)
        self.blocked_seconds = 0.0
        self._transport, self._hub, self._limits = transport, hub, limits
        self._told_epoch: int | None = None
        self._acked = 0
        self._acked_at: float | None = None
        self._mark: int | None = None  # bytes sent at `_mark_at`, of which some were not acknowledged then
        self._mark_at = 0.0
        self.limit_rate(kilobytes_per_second)

    def limit_rate(self, kilobytes_per_second: float | None) -> None:
        """Limit the rate, or with None send as fast as the connection allows."""
        self._throttle = Throttle(None if kilobytes_per_second is None else kilobytes_per_second * 1000)

    @property
    def free_at(self) -> float:
        """Monotonic time before which the rate would be exceeded."""
        return self._throttle.free_at

    @property
    def position(self) -> Position | None:
        """Position of the last packet sent."""
        return self.last.position if self.last else None

    @property
    def can_post(self) -> bool:
        """Whether the viewer may join the broadcast."""
        return self._transport.is_clear and not self._throttle.bounded and not self.is_full

    @property
    def is_full(self) -> bool:
        """Whether the send window is full. A viewer that never acknowledges has no window."""
        return self.receiver.sent > self.receiver.send_limit

    def acknowledge(self, received: int, now: float) -> None:
        """The viewer has received `received` bytes of packets.

        The send window bounds the bytes in flight. It closes when acknowledgements are late, because then packets are
        queued somewhere on the way.
        """
        receiver = self.receiver
        self._acked, self._acked_at = max(self._acked, min(received, receiver.sent)), now
        late = self._mark is not None and now - self._mark_at > _ACK_SECONDS + 2 * self._limits.viewer_lag_seconds
        if self._mark is None or self._acked >= self._mark:
            self._mark, self._mark_at = receiver.sent if receiver.sent > self._acked else None, now
        key = self._hub.keyframe
        allowed = self._limits.flight_bytes + (len(key.data) if key else 0)
        receiver.send_limit = self._acked + (0 if late else allowed)

    def must_wait(self, now: float) -> bool:
        """Whether sending has to wait, for the rate limit or for the send window.

        Raises:
            SessionError: 1013, nothing was acknowledged for too long.
        """
        if now < self.free_at:
            return True
        if not self.is_full:
            return False
        if self._acked_at is not None and now - self._acked_at > self._limits.stuck_seconds:
            raise SessionError(CloseCode.BUSY, f"nothing was acknowledged for {self._limits.stuck_seconds:g} s")
        return True

    async def send(
        self, message: BinaryMessage, packet: StreamPacket | None = None, interval_seconds: float | None = None
    ) -> None:
        """Send a packet once the write buffer has drained; `packet` is what the viewer holds afterwards.

        With an interval it goes out in pieces, one per interval; the old picture stays meanwhile.
        """
        if packet is not None:
            await self.enter(packet.position.epoch)
        begin, size = time.monotonic(), len(message.data)
        await self._transport.binary(message, interval_seconds)
        now = time.monotonic()
        self.last = packet or self.last
        self.blocked_seconds += now - begin
        self.receiver.sent += size
        self.counters.sent_bytes += size
        self._throttle.spend(size, now)

    async def enter(self, epoch: int) -> None:
        """Tell the viewer which epoch the packets that follow belong to, where that is another one."""
        if epoch != self._told_epoch:
            self._told_epoch = epoch
            await self.send_event(event("epoch", epoch=epoch))

    async def send_sound(self, message: BinaryMessage) -> None:
        """Send a piece of sound, which viewers do not acknowledge."""
        await self._transport.binary(message)
        self.counters.sent_bytes += len(message.data)

    async def send_event(self, message: dict[str, Any]) -> None:
        """Send a control message."""
        await self._transport.text(json.dumps(message))
