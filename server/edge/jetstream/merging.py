"""Packets of one stream that come by two ways, from JetStream and directly, handed on as one stream."""

from __future__ import annotations

import asyncio
import time
from typing import Literal

from streamlod.core.errors import BitstreamError
from streamlod.server.edge.jetstream.messages import LivePacket
from streamlod.server.edge.supply import PacketTaker
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Place, StreamPacket, stream_packet

_MISSED_SECONDS = 1.5  # for which those that were missed are waited for; they are sent again when asked for
Outcome = Literal["taken", "known", "gap"]


class Merger:
    """Hands on each packet once and in order, by whichever way it comes first.

    Where packets of JetStream are missing, it goes on with the next keyframe; where some of the others are, only if
    neither way brings anything for some time. The taker hears of what is missing (the event `skipped`).

    Args:
        taker: of the packets.
        epoch: of the newest packet of JetStream, where known. What comes directly is of this one or the next.

    Attributes:
        held: the newest packet that was handed on.
    """

    def __init__(self, taker: PacketTaker, epoch: int | None) -> None:
        self._taker, self._epoch = taker, epoch
        self.held: Place | None = None
        self._stored: Place | None = None  # the newest packet that came from JetStream
        self._taken_at = 0.0  # monotonic time
        self._lock = asyncio.Lock()

    async def take(self, epoch: int, data: bytes) -> None:
        """A packet of JetStream, which has them in order.

        Raises:
            BitstreamError: it is damaged.
        """
        async with self._lock:
            packet = stream_packet(0, epoch, data)
            after, self._stored = self._stored, packet.place
            if self._is_new(packet) and (packet.is_key or (self.held and packet.follows(self.held[0]))):
                await self._hand_on(packet, after)

    async def take_live(self, message: LivePacket) -> Outcome:
        """A packet that came directly; a damaged one is as good as none, since JetStream will have it."""
        async with self._lock:
            try:
                packet = stream_packet(0, message.place[0].epoch, message.data)
                if packet.place != message.place:
                    return "gap"
                if not self._is_new(packet):
                    return "known"
                if not self._fits(packet, message.after):
                    return "gap"
                await self._hand_on(packet, message.after)
            except (BitstreamError, ValueError):
                return "gap"
            return "taken"

    def _is_new(self, packet: StreamPacket) -> bool:
        return self.held is None or packet.place > self.held

    def _fits(self, packet: StreamPacket, after: Place | None) -> bool:
        """Whether a packet that came directly can be taken; `after` is the one before it."""
        if self._epoch is None or packet.position.epoch not in (self._epoch, self._epoch + 1):
            return False
        if self.held is None:
            return packet.is_key
        if after == self.held:
            return packet.follows(self.held[0])
        return packet.is_key and time.monotonic() - self._taken_at >= _MISSED_SECONDS

    async def _hand_on(self, packet: StreamPacket, after: Place | None) -> None:
        if packet.is_key and self.held is not None and after != self.held:
            self._taker.on_event(event("skipped"))
        self._taker.on_event(event("epoch", epoch=packet.position.epoch))
        await self._taker.on_packet(packet.data)
        self.held, self._epoch, self._taken_at = packet.place, packet.position.epoch, time.monotonic()
