"""The retained packets of a stream of another server: the newest packets in memory, all others in JetStream."""

from __future__ import annotations

from collections.abc import Collection

from streamlod.core.errors import InputError
from streamlod.server.edge.jetstream.archive import Archive
from streamlod.server.protocol.packets import PacketWindow, Position, StreamPacket
from streamlod.server.stream.bus import Bus, GroupFile, RetainedGroup


class ArchiveBus(Bus):
    """The newest packets in memory, all that JetStream holds behind them.

    Args:
        memory_bytes: packets kept in memory, and read at once for a download.
        archive: of the stream.
    """

    def __init__(self, memory_bytes: int, archive: Archive) -> None:
        super().__init__(memory_bytes)
        self._archive, self._memory_bytes = archive, memory_bytes

    def skip(self) -> None:
        """See `Bus`. Memory begins anew; JetStream will have what is missing, if anybody has."""
        self.window = PacketWindow(self._memory_bytes)

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        """See `Bus`.

        Raises:
            OSError: NATS does not answer.
        """
        oldest = self.window.oldest
        if oldest is not None and first >= oldest.position:
            return self.window.read(first, last)
        return await self._archive.read(first, last)

    async def groups(self) -> list[RetainedGroup]:
        """See `Bus`.

        Raises:
            OSError: NATS does not answer.
        """
        return await self._archive.groups()

    async def files(self, firsts: Collection[Position] | None = None) -> dict[Position, GroupFile]:
        """See `Bus`.

        Raises:
            InputError: they are too much for memory.
            OSError: NATS does not answer.
        """
        chosen = await self._archive.groups(firsts)
        size = sum(group.size_bytes for group in chosen)
        if size > self._memory_bytes:
            parts = "groups" if len(chosen) > 1 else "packets"
            fault = f"has {size} bytes, this server holds {self._memory_bytes}; download its {parts} one by one"
            raise InputError("the download", fault)
        read = {group.first: await self._archive.group(group.first) for group in chosen}
        return {first: packets for first, packets in read.items() if packets}

    @property
    def oldest(self) -> Position | None:
        """See `Bus`."""
        places = [self.window.oldest.position] if self.window.oldest else []
        return min([*places, *self._archive.keys[:1]], default=None)

    def _keys(self) -> list[Position]:
        return [group[0].position for group in self.window.groups()] + self._archive.keys
