"""The source of streams that are made elsewhere: which there are, and the packets of each."""

from __future__ import annotations

from typing import Protocol

from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.origin_messages import OriginMessages
from streamlod.server.stream.bus import Bus


class Supply(Protocol):
    """The packets of one stream."""

    @property
    def origin_name(self) -> str:
        """Name of the server that the streams come from, as viewers are told."""

    @property
    def bus(self) -> Bus:
        """The retained packets of a stream."""

    async def pull(self, taker: OriginMessages) -> None:
        """Hand messages to `taker` until the stream is deleted (then this returns) or the taker raises."""


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
