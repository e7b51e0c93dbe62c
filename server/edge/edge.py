"""An edge: a server whose streams come from another server."""

from __future__ import annotations

import asyncio
import logging

from server.api.registry import Registry
from server.edge.origin import Origin, OriginStream
from server.edge.stream import EdgeStream
from server.settings import EdgeSettings

_LOG = logging.getLogger(__name__)


class Edge:
    """Keeps the registry's streams those of the origin.

    Args:
        registry: of this server.
        settings: which streams of which server.
        token: for reading them, where the origin wants one.

    Raises:
        InputError: the origin is no address.
    """

    def __init__(self, registry: Registry, settings: EdgeSettings, token: str | None) -> None:
        self._registry, self._settings = registry, settings
        self._origin = Origin(settings.origin, token)
        self._described: dict[str, OriginStream] = {}
        self._closing: set[asyncio.Task[None]] = set()
        registry.unready = f"the origin {settings.origin} has not been reached yet"

    async def run(self) -> None:
        """Ask the origin for its streams again and again, until cancelled."""
        fault = ""
        while True:
            try:
                self._take_over(await self._origin.streams())
                if fault:
                    _LOG.info("the origin answers again")
                fault = self._registry.unready = ""
            except OSError as error:
                if not fault:
                    _LOG.warning("the origin %s does not say which streams it has: %s", self._origin.url, error)
                fault = str(error) or "no answer"
            await asyncio.sleep(self._settings.poll_seconds)

    def _take_over(self, described: list[OriginStream]) -> None:
        chosen = [each for each in described if not self._settings.streams or each.id in self._settings.streams]
        most = self._registry.settings.limits.streams
        if len(chosen) > most and len(self._described) < most:
            _LOG.warning("the origin has %d streams; only %d are served (limits.streams)", len(chosen), most)
        self._described = {each.id: each for each in chosen[:most]}
        for stream in self._streams():
            now = self._described.get(stream.id)
            if now is None:
                self._remove(stream)
            elif now.incarnation != stream.incarnation:
                self._replace(stream)
            else:
                stream.update(now)
        for name in self._described.keys() - self._registry.streams.keys():
            self._add(name)

    def _streams(self) -> list[EdgeStream]:
        return [stream for stream in self._registry.streams.values() if isinstance(stream, EdgeStream)]

    def _add(self, name: str) -> None:
        self._registry.streams[name] = EdgeStream(
            self._origin,
            self._described[name],
            self._registry.settings,
            self._registry.feed,
            self._settings,
            self._replace,
            self._remove,
        )

    def _replace(self, stream: EdgeStream) -> None:
        """Begin anew with a stream; its viewers are told to connect again."""
        if self._registry.streams.get(stream.id) is not stream:
            return
        stream.replaced = True
        self._end(stream)
        described = self._described.get(stream.id)
        if described is not None and not self._registry.draining:
            if stream.successor is not None:  # what the list said is out of date
                self._described[stream.id] = described.model_copy(update={"incarnation": stream.successor})
            self._add(stream.id)

    def _remove(self, stream: EdgeStream) -> None:
        """The origin has deleted a stream; its viewers are told so."""
        if self._registry.streams.get(stream.id) is stream:
            stream.deleted = True
            self._described.pop(stream.id, None)
            self._end(stream)

    def _end(self, stream: EdgeStream) -> None:
        del self._registry.streams[stream.id]
        stream.hub.wake()
        task = asyncio.create_task(stream.close())
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)
