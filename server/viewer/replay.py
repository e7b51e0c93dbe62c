"""Replay for one viewer: recorded packets, sent at the pace at which they were filmed."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

from streamlod.core.gaps import MAX_GAP_SECONDS
from streamlod.server.protocol.packets import BinaryMessage, Position, StreamPacket
from streamlod.server.stream.bus import Bus
from streamlod.server.viewer.delivery import Delivery
from streamlod.server.viewer.pacing import LevelControl

_LOG = logging.getLogger(__name__)
_CHUNK_VERSIONS = 16  # read at once
_MAX_LATE_SECONDS = 2.0  # a viewer that is later than that goes on from where it is, instead of catching up


class Replay:
    """Plays what is retained, from a position to its end.

    Args:
        bus: packets in memory and on disk.
        delivery: sends to the viewer.
        levels: how many levels it gets.

    Attributes:
        is_over: whether nothing more is retained.
        speed: seconds of filming that are played a second.
    """

    def __init__(self, bus: Bus, delivery: Delivery, levels: LevelControl) -> None:
        self._bus, self._delivery, self._levels = bus, delivery, levels
        self._ahead: deque[StreamPacket] = deque()
        self._clock = 0.0  # monotonic time of presentation time 0, at this speed
        self.speed = 1.0
        self._epoch = 0  # whose times the clock is set to
        self.is_over = False

    def clear(self) -> None:
        """Discard what was read ahead."""
        self._ahead.clear()
        self.is_over = False

    def play_at(self, speed: float, now: float) -> None:
        """Go on at another speed from where it is."""
        played = (now - self._clock) * self.speed
        self.speed = speed
        self._clock = now - played / speed

    def seconds_to_next(self, now: float) -> float | None:
        """Time until the next packet is due, if one was read ahead."""
        if not self._ahead:
            return None
        return max(0.0, self._due(self._ahead[0]) - now) if self._ahead[0].position.epoch == self._epoch else 0.0

    def played_ns(self, now: float) -> int:
        """Time of what is played now, between the picture that was sent last and the next one, as packets count it."""
        shown = self._delivery.last
        begin_ns = 0 if shown is None else shown.info.time_ns
        if not self._ahead or self._ahead[0].position.epoch != self._epoch:
            return begin_ns
        end_ns = self._ahead[0].info.time_ns
        return max(begin_ns, min(round((now - self._clock) * self.speed * 1e9), end_ns))

    async def load(self, place: Position, is_wanted: Callable[[], bool] = lambda: True) -> None:
        """Send from the last keyframe before `place`, while that is wanted; what leads to `place` is due at once.

        Where the past cannot be read now, it goes on from what was sent, or is over if that is nothing.
        """
        here, last = self._bus.key_before(place), None
        while here is not None and here <= place:
            chunk = Position(here.epoch, here.version + _CHUNK_VERSIONS - 1)
            try:
                packets = await self._bus.read(here, min(place, chunk)) or await self._bus.read(here, place)
            except OSError as error:
                _LOG.warning("a seek is not carried out: the past cannot be read now (%s)", error)
                break
            while packets and not (packets[0].is_key if last is None else packets[0].follows(last.position)):
                packets.pop(0)  # some may have left the window meanwhile
            for packet in packets:
                if not is_wanted():
                    return
                await self._send(packet)
            last = packets[-1] if packets else last
            here = Position(packets[-1].position.epoch, packets[-1].position.version + 1) if packets else None
        if last is not None:
            self._set_clock(last, time.monotonic())

    async def step(self, now: float) -> bool:
        """Send what is due, or read ahead; returns whether there is more to do at once."""
        if not self._ahead:
            await self._read_ahead()
            return bool(self._ahead)
        due, epoch = self._due(self._ahead[0]), self._ahead[0].position.epoch
        if epoch != self._epoch or now - due > _MAX_LATE_SECONDS:
            self._set_clock(self._ahead[0], now)  # times of two epochs cannot be compared
        elif due > now:
            self._clock -= max(0.0, due - now - MAX_GAP_SECONDS / self.speed)  # nobody waits while nothing was filmed
            return False
        await self._send(self._ahead.popleft())
        return True

    async def _read_ahead(self) -> None:
        """The next versions of the past, from the next keyframe where some are missing."""
        if self._delivery.last is None:  # what was asked for left the window before it was sent
            self.is_over = True
            return
        here = self._delivery.last.position
        try:
            packets = await self._bus.read(
                Position(here.epoch, here.version + 1), Position(here.epoch, here.version + _CHUNK_VERSIONS)
            )
            if not packets or not packets[0].follows(here):
                key = self._bus.key_after(here)
                packets = await self._bus.read(key, key) if key else []
                packets = packets[-1:]
        except OSError:  # it cannot be read now; the session asks again
            return
        self._ahead.extend(packets)
        self.is_over = not self._ahead

    def _set_clock(self, packet: StreamPacket, now: float) -> None:
        self._epoch = packet.position.epoch
        self._clock = now - packet.info.time_ns / 1e9 / self.speed

    def _due(self, packet: StreamPacket) -> float:
        return self._clock + packet.info.time_ns / 1e9 / self.speed

    async def _send(self, packet: StreamPacket) -> None:
        await self._delivery.send(BinaryMessage(packet.restricted(self._levels.levels)), packet)
