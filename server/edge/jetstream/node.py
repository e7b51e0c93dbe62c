"""This server's part in sharing streams over JetStream: what it publishes, and what it serves of others."""

from __future__ import annotations

import asyncio
import logging
from types import TracebackType
from typing import Self

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import Directory
from streamlod.server.edge.jetstream.messages import Names
from streamlod.server.edge.jetstream.publisher import Publisher
from streamlod.server.edge.jetstream.supply import ArchivedStream
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.supply import Supply
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Outbox
from streamlod.server.stream.stream import Stream

_LOG = logging.getLogger(__name__)
_LOOK_SECONDS = 0.25  # between two looks for streams to publish


class JetStream:
    """A source of streams, and the outboxes of this server's own; connected between enter and exit.

    Args:
        settings: of the server.
    """

    name = "NATS JetStream"

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._names = Names(settings.jetstream.prefix)
        self._connection = NatsConnection(settings.jetstream)
        self._directory = Directory(self._connection, self._names, settings)
        self._publishers: list[Publisher] = []
        self._publishing: dict[str, tuple[Publisher, asyncio.Task[None]]] = {}
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            async with asyncio.timeout(self._settings.drain_seconds / 4):
                await asyncio.gather(*(publisher.finish() for publisher, _ in self._publishing.values()))
        except Exception as fault:
            _LOG.warning("not everything was published: %s", fault or "NATS does not answer")
        tasks = [task for _, task in self._publishing.values()]
        tasks += [] if self._task is None else [self._task]
        await end(*tasks)
        await self._connection.close()

    def outbox(self, stream: Stream) -> Outbox:
        """Publish a stream from now on."""
        publisher = Publisher(self._connection, self._names, self._settings, stream)
        self._publishers.append(publisher)
        return publisher

    async def streams(self) -> list[OriginStream]:
        """See `StreamSource`: the streams of other servers."""
        if self._directory.fault:
            raise OSError(self._connection.fault or self._directory.fault)
        own = {publisher.stream.id for publisher in self._publishers}
        return [each for each in self._directory.streams() if each.id not in own]

    async def edges(self) -> tuple[str, ...]:
        """See `StreamSource`: none are known beside the setting."""
        return ()

    def supply(self, stream: OriginStream) -> Supply:
        """See `StreamSource`."""
        return ArchivedStream(self._connection, self._names, self._directory, self._settings, stream)

    async def _run(self) -> None:
        try:
            await self._connection.open()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._directory.run())
                while True:
                    self._look()
                    await asyncio.sleep(_LOOK_SECONDS)
        except Exception as error:
            self._directory.fault = f"sharing streams broke off ({error})"
            _LOG.exception("streams are no longer shared; restart this server")

    def _look(self) -> None:
        """Begin to publish new streams; one of a deleted stream's id waits until that is removed."""
        for name, (publisher, task) in list(self._publishing.items()):
            if task.done():
                if not task.cancelled() and (error := task.exception()) is not None:
                    _LOG.error("stream %s: publishing broke and begins again", name, exc_info=error)
                else:
                    self._publishers.remove(publisher)
                del self._publishing[name]
        for publisher in self._publishers:
            if publisher.stream.id not in self._publishing:
                self._publishing[publisher.stream.id] = publisher, asyncio.create_task(publisher.run())
