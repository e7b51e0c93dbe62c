"""An edge: a server whose streams come from elsewhere, from another server or from JetStream."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress

from streamlod.core.masking import masked
from streamlod.server.api.registry import Registry
from streamlod.server.edge.origin import REFUSED_SECONDS, OriginStream
from streamlod.server.edge.stream import EdgeStream
from streamlod.server.edge.supply import StreamSource

_LOG = logging.getLogger(__name__)
_MAX_TOLD = 20  # reasons: a hostile origin may have a new one each time


class Edge:
    """Keeps the registry's streams those of the origin.

    Args:
        registry: of this server.
        source: of the streams.
        poll_seconds: between two looks at which streams there are.
        linger_seconds: for which a stream is pulled after its last viewer has gone.
    """

    def __init__(self, registry: Registry, source: StreamSource, poll_seconds: float, linger_seconds: float) -> None:
        self._registry, self._source = registry, source
        self._poll_seconds, self._linger_seconds = poll_seconds, linger_seconds
        self._described: dict[str, OriginStream] = {}
        self._closing: set[asyncio.Task[None]] = set()
        registry.unready = f"{source.name} has not been reached yet"

    async def run(self) -> None:
        """Ask the origin for its streams again and again, until cancelled."""
        try:
            await self._follow()
        finally:  # what a pull has open is closed before the server's event loop is
            await asyncio.gather(*self._closing, return_exceptions=True)

    async def _follow(self) -> None:
        told = set[str]()  # reasons, since it last answered
        while True:
            pause = self._poll_seconds
            try:
                self._take_over(await self._source.streams())
                if told:
                    _LOG.info("%s answers again", self._source.name)
                told.clear()
                self._registry.unready = ""
            except OSError as error:
                reason = masked(str(error)) or "no answer"
                if reason not in told and len(told) < _MAX_TOLD:
                    _LOG.warning("%s does not say which streams there are: %s", self._source.name, reason)
                    told.add(reason)
                if isinstance(error, PermissionError):
                    pause = max(pause, REFUSED_SECONDS)
            else:
                with suppress(OSError):  # an origin that does not tell them has none, or those that it told before
                    self._registry.edges = self._registry.settings.edges or await self._source.edges()
            await asyncio.sleep(pause)

    def _take_over(self, described: list[OriginStream]) -> None:
        most = self._registry.settings.limits.streams
        if len(described) > most and len(self._described) < most:
            _LOG.warning("there are %d streams; only %d are served (limits.streams)", len(described), most)
        self._described = {each.id: each for each in described[:most]}
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
            self._described[name],
            self._source.supply(self._described[name]),
            self._registry.settings,
            self._registry.feed,
            self._registry.traces,
            self._linger_seconds,
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
