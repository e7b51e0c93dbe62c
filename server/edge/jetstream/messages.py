"""Packets as messages of JetStream: their subjects, their ids, and the pieces of large ones."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from streamlod.server.protocol.packets import Position, StreamPacket

MAX_PIECE_BYTES = 1 << 19  # NATS takes messages of 1 MiB unless it is configured otherwise
MAX_HEADER_BYTES = 4096  # of a message
MSG_ID = "Nats-Msg-Id"  # the header that has a message's id
_ID = re.compile(r"([0-9a-f]{16})/(\d{1,10})/(\d{1,10})/([kr])/(\d{1,4})/(\d{1,4})")


@dataclass(frozen=True, slots=True)
class Names:
    """Names of streams and subjects.

    Args:
        prefix: of all of them.
    """

    prefix: str

    @property
    def directory(self) -> str:
        """The JetStream stream of descriptions."""
        return f"{self.prefix}-streams"

    def description(self, stream: str) -> str:
        """Subject of a stream's description; of all of them with ``*``."""
        return f"{self.prefix}.streams.{stream}"

    def packets(self, stream: str) -> str:
        """The JetStream stream of a stream's packets."""
        return f"{self.prefix}-packets-{stream}"

    def subject(self, stream: str, incarnation: str, kind: str) -> str:
        """Subject of keyframes (kind ``k``), of residuals (``r``), of pieces of sound (``s``), or of all (``*``)."""
        return f"{self.prefix}.packets.{stream}.{incarnation}.{kind}"


@dataclass(frozen=True, slots=True)
class MessageId:
    """The content of a message. JetStream stores two messages of one id as one.

    Attributes:
        incarnation: of the stream.
        position: of the packet.
        is_key: whether it is a keyframe; one may share its position with the residual before it.
        piece, pieces: which piece of the packet this is, and of how many.
    """

    incarnation: str
    position: Position
    is_key: bool
    piece: int
    pieces: int

    @property
    def kind(self) -> str:
        """Text of the position, as in the subject."""
        return "k" if self.is_key else "r"

    @property
    def is_last(self) -> bool:
        """Whether the packet ends here."""
        return self.piece == self.pieces - 1

    def __str__(self) -> str:
        place = self.position
        return f"{self.incarnation}/{place.epoch}/{place.version}/{self.kind}/{self.piece}/{self.pieces}"


def parse_id(text: str) -> MessageId | None:
    """The id, or None where it is none."""
    match = _ID.fullmatch(text)
    if match is None:
        return None
    epoch, version, piece, pieces = (int(match[group]) for group in (2, 3, 5, 6))
    return MessageId(match[1], Position(epoch, version), match[4] == "k", piece, pieces) if piece < pieces else None


def pieces_of(incarnation: str, packet: StreamPacket, max_bytes: int) -> Iterator[tuple[MessageId, bytes]]:
    """A packet's messages, of at most `max_bytes` each."""
    count = -(-len(packet.data) // max_bytes)
    for piece in range(count):
        begin = piece * max_bytes
        found = MessageId(incarnation, packet.position, packet.is_key, piece, count)
        yield found, packet.data[begin : begin + max_bytes]


class Assembler:
    """Puts packets together again from messages in the order in which they are stored.

    A packet of which a piece is missing is left out as a whole, and a message that is stored twice counts once.

    Args:
        max_bytes: of a packet.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max = max_bytes
        self._last: MessageId | None = None
        self._next: MessageId | None = None  # the piece that has to come
        self._parts: list[bytes] = []
        self._size = 0

    def push(self, found: MessageId, data: bytes) -> bytes | None:
        """The packet, if this was its last piece."""
        if found == self._last:
            return None
        self._last = found
        if found.piece == 0:
            self._parts, self._size = [], 0
        elif found != self._next:
            self._next = None
            return None
        self._parts.append(data)
        self._size += len(data)
        self._next = replace(found, piece=found.piece + 1)
        if self._size > self._max:
            self._next, self._parts = None, []
            return None
        return b"".join(self._parts) if found.is_last else None
