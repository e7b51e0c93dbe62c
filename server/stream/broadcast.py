"""Viewers that have everything so far: what comes next is written to all of them in one loop.

With many viewers the time goes into memory that is touched for each of them. So a lane is one small object, and nothing
is asked for each packet: whatever gets in the way of a viewer takes its lane off the list.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from server.protocol.packets import StreamPacket, payload_bytes
from server.stream.counters import Counters


class Lane:
    """The short way to one viewer.

    Args:
        write: takes a whole websocket frame without waiting.
        rouse: called when the lane must be left; it has to call `Lanes.leave`.

    Attributes:
        sent: bytes of packets that the viewer was given, by this way or another.
        ceiling: value of `sent` above which it has to acknowledge some before it gets more.
        levels: that it gets while it is on the list, otherwise 0.
    """

    __slots__ = ("ceiling", "levels", "rouse", "sent", "write")

    def __init__(self, write: Callable[[bytes], None], rouse: Callable[[], None]) -> None:
        self.write, self.rouse = write, rouse
        self.sent, self.ceiling, self.levels = 0, sys.maxsize, 0


class Lanes:
    """All lanes of a stream that are open.

    Args:
        counters: where bytes are counted.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._groups: dict[int, set[Lane]] = {}
        self._depth = 0  # levels of the newest packet

    def enter(self, lane: Lane, levels: int) -> None:
        """Give the viewer every packet from now on, with so many levels."""
        self._groups.setdefault(levels, set()).add(lane)
        lane.levels = levels

    def leave(self, lane: Lane) -> None:
        """No more packets for this viewer."""
        self._groups[lane.levels].discard(lane)
        lane.levels = 0

    def pass_on(self, packet: StreamPacket, message: bytes = b"") -> None:
        """Write a packet to all, and a framed control message with it, as one write costs much less than two."""
        for levels, group in self._groups.items():
            if not group:
                continue
            frame = packet.framed(levels)
            size, lanes = payload_bytes(frame), tuple(group)  # a write may block, and take its lane off the list
            frame += message
            for lane in lanes:
                lane.sent += size
                lane.write(frame)
                if lane.sent > lane.ceiling:
                    lane.rouse()
            self._counters.sent_bytes += size * len(lanes)
        depth, self._depth = self._depth, packet.info.level_mask.bit_length()
        if depth != self._depth:  # there may be more that a viewer wants
            self.rouse()

    def rouse(self) -> None:
        """Let every viewer look what is to be done."""
        for lane in [lane for group in self._groups.values() for lane in group]:
            lane.rouse()
