"""Packets of one stream that come by two ways, from JetStream and directly, handed on as one stream."""

from __future__ import annotations

import asyncio
import time
from typing import Literal

from core.errors import BitstreamError
from server.edge.jetstream.messages import Place
from server.edge.supply import PacketTaker
from server.protocol.messages import event
from server.protocol.packets import StreamPacket, stream_packet

_MISSED_SECONDS = 1.5  # for which those that were missed are waited for; they are sent again when asked for
Outcome = Literal["taken", "known", "gap"]


class Merger:
    """Hands on each packet once and in order, by whichever way it comes first.

    Where packets of JetStream are missing, it goes on with the next keyframe; where some of the others are, only if
    neither way brings anything for some time.

    Args:
        taker: of the packets.

    Attributes:
        held: the newest packet that was handed on.
    """

    def __init__(self, taker: PacketTaker) -> None:
        self._taker = taker
        self.held: Place | None = None
        self._taken_at = 0.0  # monotonic time
        self._lock = asyncio.Lock()

    async def take(self, epoch: int, data: bytes) -> None:
        """A packet of JetStream.

        Raises:
            BitstreamError: it is damaged.
        """
        async with self._lock:
            await self._take(epoch, data, 0.0)

    async def take_live(self, epoch: int, data: bytes) -> Outcome:
        """A packet that came directly; a damaged one is as good as none, since JetStream will have it."""
        async with self._lock:
            try:
                return await self._take(epoch, data, _MISSED_SECONDS)
            except BitstreamError:
                return "gap"

    async def _take(self, epoch: int, data: bytes, missed_seconds: float) -> Outcome:
        packet = stream_packet(0, epoch, data)
        place = packet.position, packet.is_key
        if self.held is not None and place <= self.held:
            return "known"
        if not self._fits(packet, missed_seconds):
            return "gap"
        self._taker.on_event(event("epoch", epoch=epoch))
        await self._taker.on_packet(data)
        self.held, self._taken_at = place, time.monotonic()
        return "taken"

    def _fits(self, packet: StreamPacket, missed_seconds: float) -> bool:
        if self.held is None:
            return packet.is_key
        held, found = self.held[0], packet.position
        if packet.is_key and found.epoch == held.epoch and found.version > held.version + 1:
            return time.monotonic() - self._taken_at >= missed_seconds
        return packet.follows(held)
