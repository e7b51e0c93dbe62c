"""Very many viewers in one process: what has come is looked at a few times a second, so that a viewer costs little.

They say hello, acknowledge and answer pings as docs/protocol.md asks. When a packet came is known to a fifth of a
second only; `fanout_viewers` knows it exactly, for fewer viewers.
"""

from __future__ import annotations

import os
import socket
import time
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from tests.bench.fanout_viewers import join, masked

_LOOK_SECONDS = 0.2
_ACK_SECONDS = 0.8
_READ_BYTES = 1 << 20
_VERSION_AT = 16  # of the packet's field to_version
_CLOSE, _PING, _PONG, _TEXT, _BINARY = 8, 9, 10, 1, 2


@dataclass(slots=True)
class Reader:
    """One connection; `left` bytes of a frame that has begun are still to come."""

    peer: socket.socket
    waiting: bytearray = field(default_factory=bytearray)
    left: int = 0
    received: int = 0
    acked_at: float = 0.0

    def look(self, now: float, packets: Counter[int]) -> bool:
        """Take what has come, and count packets by version; False where the connection has ended."""
        try:
            while True:
                data = self.peer.recv(_READ_BYTES, socket.MSG_DONTWAIT)
                if not data:
                    return False
                self._take(data, packets)
                if len(data) < _READ_BYTES:
                    break
        except BlockingIOError:
            pass
        except OSError:
            return False
        if now - self.acked_at > _ACK_SECONDS:
            self.acked_at = now
            self.peer.sendall(masked(_TEXT, b'{"type":"ack","bytes":%d,"epoch":1,"version":0}' % self.received))
        return True

    def _take(self, data: bytes, packets: Counter[int]) -> None:
        if self.waiting:
            data, self.waiting = bytes(self.waiting) + data, bytearray()
        at = min(self.left, len(data))
        self.left -= at
        while at < len(data):
            short = data[at + 1] & 127 if at + 1 < len(data) else 0
            head = 2 if short < 126 else 4 if short == 126 else 10
            if len(data) - at < head + _VERSION_AT + 4:
                size = short if head == 2 else 1 << 30
                if len(data) - at < head + size:
                    self.waiting += data[at:]
                    return
            size = short if head == 2 else int.from_bytes(data[at + 2 : at + head], "big")
            opcode = data[at] & 15
            if opcode in {0, _BINARY}:
                self.received += size
            if opcode == _BINARY:
                packets[int.from_bytes(data[at + head + _VERSION_AT : at + head + _VERSION_AT + 4], "little")] += 1
            elif opcode == _PING:
                self.peer.sendall(masked(_PONG, data[at + head : at + head + size]))
            elif opcode == _CLOSE:
                raise ConnectionError("closed")
            at += head + size
        self.left = at - len(data)


def watch(pipe: Connection, core: int, port: int) -> None:
    """Main function of the process. Commands: a number of viewers to add, answered by None; "collect", answered by the
    packets since the last time as a Counter of versions, the bytes received so far and the viewers that were lost; None
    ends it."""
    os.sched_setaffinity(0, {core})
    readers: list[Reader] = []
    packets: Counter[int] = Counter()
    lost = 0
    due = time.monotonic()
    wanted = 0
    while True:
        if wanted:
            readers.append(Reader(join(port)))
            wanted -= 1
            if not wanted:
                pipe.send(None)
        elif pipe.poll(max(0.0, due - time.monotonic())):
            command = pipe.recv()
            if command is None:
                return
            if command == "collect":
                pipe.send((packets, sum(reader.received for reader in readers), lost))
                packets = Counter()
            elif command == 0:
                pipe.send(None)
            else:
                wanted = command
        if (now := time.monotonic()) >= due:
            due = now + _LOOK_SECONDS
            alive = [reader for reader in readers if reader.look(now, packets)]
            lost += len(readers) - len(alive)
            readers = alive
