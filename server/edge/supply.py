"""The source of streams that are made elsewhere: which there are, and the packets of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from streamlod.server.edge.origin import OriginStream
from streamlod.server.protocol.packets import Position
from streamlod.server.stream.bus import Bus

Tell = Callable[[dict[str, Any]], None]


class PacketTaker(Protocol):
    """Whoever takes what is pulled. Whatever these methods raise ends the pull."""

    @property
    def held(self) -> Position | None:
        """Position of the newest packet that it has, from which to go on."""

    def on_welcome(self, message: dict[str, Any], sent_ns: int, present: Tell | None = None) -> None:
        """The origin has taken us; the hello left at Unix time `sent_ns`. `present` asks it to show a view."""

    def on_event(self, message: dict[str, Any]) -> None:
        """An event, in order with the packets."""

    async def on_packet(self, data: bytes) -> None:
        """A packet."""

    def on_sound(self, data: bytes) -> None:
        """A piece of live sound."""

    def on_break(self, reason: str) -> None:
        """The connection broke, or could not be opened; another attempt follows."""


class Supply(Protocol):
    """The packets of one stream."""

    @property
    def origin_name(self) -> str:
        """Name of the server that the streams come from, as viewers are told."""

    @property
    def bus(self) -> Bus:
        """The retained packets of a stream."""

    async def pull(self, taker: PacketTaker) -> None:
        """Hand packets to `taker` until the stream is deleted (then this returns) or the taker raises."""


class StreamSource(Protocol):
    """Streams that are made elsewhere."""

    @property
    def name(self) -> str:
        """Its name in the log, such as "the origin"."""

    async def streams(self) -> list[OriginStream]:
        """All streams that are supplied.

        Raises:
            OSError: that cannot be found out now.
        """

    async def edges(self) -> tuple[str, ...]:
        """Addresses of servers that serve these streams.

        Raises:
            OSError: that cannot be found out now.
        """

    def supply(self, stream: OriginStream) -> Supply:
        """The packets of one of them."""
