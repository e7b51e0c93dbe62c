"""Many viewers in one process: they read, acknowledge, and note when each packet was complete; nothing is decoded."""

from __future__ import annotations

import os
import select
import socket
import struct
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

_HANDSHAKE = (
    b"GET /v1/streams/%s/live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Protocol: streamlod.v1\r\n\r\n"
)
_HELLO = b'{"type":"hello","versions":[1],"client":"bench/1"}'
_ACK_EVERY = 32
_ACK_SECONDS = 1.0
_KIND_AT, _VERSION_AT = 6, 16  # of the packet's fields kind, 0 for a keyframe, and to_version
_HEAD_BYTES = _VERSION_AT + 4
_SCRATCH = bytearray(1 << 20)


@dataclass(slots=True)
class Viewer:
    """One connection; `left` bytes of a frame of the packet of `version` are still to come."""

    peer: socket.socket
    waiting: bytearray = field(default_factory=bytearray)
    left: int = 0
    final: bool = True
    version: int = 0
    is_key: bool = False
    acked_at: float = 0.0
    packets: int = 0
    received: int = 0
    reason: str = ""

    def pump(self) -> int | None:
        """Read once; the version of a packet that is complete now."""
        if self.left:  # thrown away inside the kernel, so that this process costs little
            taken = self.peer.recv_into(_SCRATCH, min(self.left, len(_SCRATCH)), socket.MSG_TRUNC)
            if not taken:
                raise ConnectionError("closed")
            self.left -= taken
            return self._complete_if_whole()
        data = self.peer.recv(64)
        if not data:
            raise ConnectionError("closed")
        self.waiting += data
        return self._parse()

    def take_text(self, text: bytes) -> None:
        """A control message has come; for those who want to know."""

    def _parse(self) -> int | None:
        while len(self.waiting) >= 2:
            short = self.waiting[1] & 127
            head = 2 if short < 126 else 4 if short == 126 else 10
            if len(self.waiting) < head:
                return None
            size = short if head == 2 else int.from_bytes(self.waiting[2:head], "big")
            opcode = self.waiting[0] & 15
            if opcode == 0 or (opcode == 2 and len(self.waiting) >= head + _HEAD_BYTES):
                if opcode == 2:
                    self.is_key = self.waiting[head + _KIND_AT] == 0
                    (self.version,) = struct.unpack_from("<I", self.waiting, head + _VERSION_AT)
                self.final = self.waiting[0] >= 0x80
                self.received += size
                here = min(size, len(self.waiting) - head)
                del self.waiting[: head + here]
                self.left = size - here
                if self.left or self.final:
                    return self._complete_if_whole()
                continue
            if opcode == 2 or len(self.waiting) < head + size:
                return None
            if opcode == 8:
                self.reason = self.waiting[head + 2 : head + size].decode()
            elif opcode == 1:
                self.take_text(bytes(self.waiting[head : head + size]))
            elif opcode == 9:
                self.peer.sendall(masked(10, bytes(self.waiting[head : head + size])))
            del self.waiting[: head + size]
        return None

    def _complete_if_whole(self) -> int | None:
        """A large keyframe comes in several frames, the last of which is final."""
        return self.complete() if self.final and not self.left else None

    def complete(self) -> int:
        """A packet is whole: acknowledge now and then; its version."""
        self.packets += 1
        now = time.monotonic()
        if self.packets >= _ACK_EVERY or now - self.acked_at >= _ACK_SECONDS:
            self.acknowledge(now)
        return self.version

    def acknowledge(self, now: float) -> None:
        """Acknowledge what has come."""
        self.packets, self.acked_at = 0, now
        self.peer.sendall(masked(1, b'{"type":"ack","bytes":%d,"epoch":1,"version":0}' % self.received))


def masked(opcode: int, data: bytes) -> bytes:
    """A client's websocket frame of less than 126 bytes, with a mask of zeros."""
    return bytes((0x80 | opcode, 0x80 | len(data))) + bytes(4) + data


def watch(pipe: Connection, core: int, port: int) -> None:
    """Main function of the viewers' process. Commands: (viewers to add, stuck viewers to add), answered by None;
    "collect", answered by the arrivals since the last time, as [(version, monotonic ns)], the bytes received and the
    reasons with which viewers were closed; None ends it."""
    os.sched_setaffinity(0, {core})
    poll = select.epoll()
    poll.register(pipe.fileno(), select.EPOLLIN)
    viewers: dict[int, Viewer] = {}
    stuck: list[socket.socket] = []
    arrivals: list[tuple[int, int]] = []
    reasons: list[str] = []
    while True:
        for descriptor, _ in poll.poll(1.0, 512):
            if descriptor == pipe.fileno():
                command = pipe.recv()
                if command is None:
                    return
                if command == "collect":
                    pipe.send((arrivals, sum(viewer.received for viewer in viewers.values()), reasons))
                    arrivals = []
                    continue
                for _ in range(command[0]):
                    viewer = Viewer(join(port))
                    viewers[viewer.peer.fileno()] = viewer
                    poll.register(viewer.peer.fileno(), select.EPOLLIN)
                stuck += [join(port, 4096) for _ in range(command[1])]
                pipe.send(None)
                continue
            viewer = viewers[descriptor]
            try:
                version = viewer.pump()
            except OSError as error:
                reasons.append(viewer.reason or str(error))
                poll.unregister(descriptor)
                del viewers[descriptor]
                continue
            if version is not None:
                arrivals.append((version, time.monotonic_ns()))


def join(port: int, receive_bytes: int | None = None, stream: str = "main") -> socket.socket:
    """A socket that has said hello to a stream."""
    peer = socket.socket()
    if receive_bytes is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    peer.settimeout(20)
    peer.connect(("127.0.0.1", port))
    peer.sendall(_HANDSHAKE % stream.encode())
    answer = b""
    while not answer.endswith(b"\r\n\r\n"):
        answer += peer.recv(1)
    assert b" 101 " in answer, answer
    peer.sendall(masked(1, _HELLO))
    return peer
