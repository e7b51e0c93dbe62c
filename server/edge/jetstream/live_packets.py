"""Packets that a publisher may have to send directly: those stored lately, and those that wait for JetStream."""

from __future__ import annotations

import time
from bisect import bisect_right
from dataclasses import dataclass

from streamlod.server.protocol.packets import Place, StreamPacket

_RECENT_SECONDS = 4.0  # what was stored so lately may not have reached every reader
_MAX_BYTES = 4 << 20  # of packets sent at once; of more than that, only those from the newest keyframe on


@dataclass(slots=True)
class Outgoing:
    """A packet of a live stream.

    Attributes:
        packet: to be sent.
        after: the packet before it, where known.
        since: monotonic time since when it waits.
        stored_at: monotonic time at which it was stored, if it was.
    """

    packet: StreamPacket
    after: Place | None
    since: float
    stored_at: float = 0.0


class LivePackets:
    """They are in order, and places among them are told by sequence: what is behind one is to be sent."""

    def __init__(self) -> None:
        self._packets: list[Outgoing] = []
        self._stored = 0  # how many of these are stored
        self._newest: Place | None = None

    def append(self, packet: StreamPacket) -> None:
        """Take note of the newest packet, which waits for JetStream from now on."""
        self._packets.append(Outgoing(packet, self._newest, time.monotonic()))
        self._newest = packet.place

    def store(self) -> None:
        """JetStream has the oldest packet that waited; forget those that readers have from it by now."""
        now = time.monotonic()
        self._packets[self._stored].stored_at = now
        self._stored += 1
        old = 0
        while old < self._stored and now - self._packets[old].stored_at > _RECENT_SECONDS:
            old += 1
        del self._packets[:old]
        self._stored -= old

    def clear(self) -> None:
        """Forget all packets: those that wait are left out, and who has some of them is to begin anew."""
        self._packets.clear()
        self._stored, self._newest = 0, None

    @property
    def waiting_since(self) -> float | None:
        """Monotonic time since when the oldest waits, None where none does."""
        return self._packets[self._stored].since if self._stored < len(self._packets) else None

    @property
    def newest_stored(self) -> int:
        """Sequence of the newest packet that was stored, -1 where there is none."""
        return self._packets[self._stored - 1].packet.sequence if self._stored else -1

    def behind(self, sequence: int) -> list[Outgoing]:
        """All packets after this one."""
        return self._packets[self._place_behind(sequence) :]

    def following(self, sequence: int) -> Outgoing | None:
        """The first packet after this one."""
        at = self._place_behind(sequence)
        return self._packets[at] if at < len(self._packets) else None

    def limited(self, sequence: int) -> int:
        """Where to begin instead so that it is not too much: before the newest keyframe, if there is one."""
        behind = self.behind(sequence)
        if _size(behind) <= _MAX_BYTES:
            return sequence
        keys = [outgoing.packet.sequence for outgoing in behind if outgoing.packet.is_key]
        return keys[-1] - 1 if keys else sequence

    def begin(self, held: Place | None) -> int | None:
        """Where to begin for a reader: at what it holds, or with a keyframe; None if that is impossible or too much."""
        packets = [outgoing.packet for outgoing in self._packets]
        if held is not None and packets and held == self._packets[0].after:
            found = [packets[0].sequence - 1]
        else:
            found = [packet.sequence for packet in packets if held is not None and packet.place <= held][-1:]
            found = found or [packet.sequence - 1 for packet in packets if packet.is_key]
        begin = self.limited(found[0]) if found else None
        return None if begin is None or _size(self.behind(begin)) > _MAX_BYTES else begin

    def _place_behind(self, sequence: int) -> int:
        return bisect_right(self._packets, sequence, key=lambda outgoing: outgoing.packet.sequence)


def _size(packets: list[Outgoing]) -> int:
    return sum(len(outgoing.packet.data) for outgoing in packets)
