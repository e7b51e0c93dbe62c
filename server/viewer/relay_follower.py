"""A server that serves the stream on (an edge): how it follows the live edge."""

from __future__ import annotations

from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, StreamPacket
from streamlod.server.settings import Limits
from streamlod.server.stream.stream import Stream
from streamlod.server.viewer.delivery import Delivery
from streamlod.server.viewer.follower import Follower
from streamlod.server.viewer.pacing import LevelControl


class RelayFollower(Follower):
    """Sends every packet as it was published, whole and in order; nothing is made for this receiver alone.

    It begins with the packet at `start` while the hub's window reaches back that far, otherwise with the newest
    keyframe. A receiver that falls out of the window is told so by a `skipped` event and begins anew.

    Args:
        stream, delivery, levels, limits: as of `Follower`.
        start: position of the newest packet that the receiver has; it is sent again, so that both can tell that they
            speak of the same packet. None if it has none.
    """

    def __init__(
        self, stream: Stream, delivery: Delivery, levels: LevelControl, limits: Limits, start: Position | None
    ) -> None:
        super().__init__(stream, delivery, levels, limits)
        self._start = start

    async def step(self, now: float) -> bool:
        """Send the next packet; returns whether there was one."""
        newest = self._hub.newest
        assert newest is not None
        if self._sequence == newest.sequence:
            return await self._when_up_to_date(now)
        packet = await self._next()
        if packet is None:
            return False
        self._sequence = packet.sequence
        await self._delivery.send(packet.message(self._levels.levels), packet)
        return True

    async def _next(self) -> StreamPacket | None:
        """The packet to send now, or None while there is nothing new for this receiver."""
        window, newest, keyframe = self._hub.window, self._hub.newest, self._hub.keyframe
        assert newest is not None
        if self._sequence is not None:
            following = window.after(self._sequence)
            if following is not None:
                return following
            limits = {"from": self._delivery.last.position.version if self._delivery.last else 0}
            await self._delivery.send_event(event("skipped", **limits, to=newest.position.version, reason="congestion"))
            return keyframe
        oldest = window.oldest
        if self._start is None or (oldest is not None and self._start < oldest.position):
            return keyframe
        return next(iter(window.read(self._start, newest.position)), None)
