"""The fast path for viewers that are up to date: each new packet is written to all of them in one loop.

With many viewers, most of the time goes into touching each one's memory. So a receiver is one small object, and the
loop asks it no questions: whatever must stop a viewer from getting packets takes its receiver out of the broadcast.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from streamlod.server.protocol.packets import StreamPacket
from streamlod.server.stream.counters import Counters


class Receiver:
    """One viewer, as the broadcast sees it.

    Args:
        write: writes a whole websocket frame without waiting.
        notify: called when the receiver must leave the broadcast; it has to call `Broadcast.remove`.

    Attributes:
        sent: bytes of packets sent to the viewer, by broadcast or otherwise.
        send_limit: value of `sent` above which the viewer has to acknowledge packets before it gets more.
        levels: levels that it gets while it is in the broadcast, otherwise 0.
    """

    __slots__ = ("levels", "notify", "send_limit", "sent", "write")

    def __init__(self, write: Callable[[bytes], None], notify: Callable[[], None]) -> None:
        self.write, self.notify = write, notify
        self.sent, self.send_limit, self.levels = 0, sys.maxsize, 0


class Broadcast:
    """All receivers of a stream that are up to date.

    Args:
        counters: where bytes are counted.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._groups: dict[int, set[Receiver]] = {}  # by number of levels
        self._depth = 0  # levels of the newest packet

    def add(self, receiver: Receiver, levels: int) -> None:
        """Send the viewer every packet from now on, with so many levels."""
        self._groups.setdefault(levels, set()).add(receiver)
        receiver.levels = levels

    def remove(self, receiver: Receiver) -> None:
        """Send this viewer no more packets."""
        self._groups[receiver.levels].discard(receiver)
        receiver.levels = 0

    def send(self, packet: StreamPacket, message: bytes = b"") -> None:
        """Write a packet to all receivers, with a framed control message appended: one write is cheaper than two."""
        for levels, group in self._groups.items():
            if not group:
                continue
            carried = packet.message(levels)
            size, receivers = len(carried.data), tuple(group)  # a write may block, which removes the receiver
            frame = carried.frame + message
            for receiver in receivers:
                receiver.sent += size
                receiver.write(frame)
                if receiver.sent > receiver.send_limit:
                    receiver.notify()
            self._counters.sent_bytes += size * len(receivers)
        depth, self._depth = self._depth, packet.info.level_mask.bit_length()
        if depth != self._depth:  # viewers may want the levels that are new
            self.notify_all()

    def notify_all(self) -> None:
        """Wake every viewer's session, which takes its receiver out of the broadcast."""
        for receiver in [receiver for group in self._groups.values() for receiver in group]:
            receiver.notify()
