"""A connection that is left for another server, without a gap in the picture, when its own is to stop."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Iterable
from dataclasses import dataclass

from websockets.exceptions import WebSocketException

from streamlod.client.connection.edges import at_edges, nearest
from streamlod.client.connection.link import StreamLink, WatchOptions
from streamlod.client.events import Event, NewScene, Notice, Welcome
from streamlod.client.playback import Playback
from streamlod.core.errors import SessionError

_log = logging.getLogger(__name__)
_MOVE_SECONDS = 5.0  # for the new connection to be where the old one is


@dataclass(frozen=True, slots=True)
class _Joined:
    """A connection that was made beside another one.

    Attributes:
        incarnation: of the stream there. Only under the same one are positions the same.
        events: told so far; of scenes only the newest one.
    """

    link: StreamLink
    incarnation: str
    events: list[Event]


class MovingLink:
    """Connections one after the other, the next one made before the last one ends.

    Args:
        url: live websocket of the stream, where to begin.
        options: what to ask the servers for.
    """

    def __init__(self, url: str, options: WatchOptions) -> None:
        self._link, self._options = StreamLink(url, options), options
        self._incarnation = ""
        self._move: asyncio.Task[_Joined | None] | None = None
        self._closing: list[asyncio.Task[None]] = []

    @property
    def url(self) -> str:
        """Where it is connected."""
        return self._link.url

    @property
    def playback(self) -> Playback:
        """The state of the stream."""
        return self._link.playback

    async def events(self, start: tuple[int, int] | None) -> AsyncGenerator[Event, None]:
        """The events of the stream; no scene is older than one before it only because the server is another.

        Raises:
            OSError, WebSocketException, SessionError: what ended the connection.
        """
        await self._link.open(start)
        async for event in self._told():
            yield event
        while True:
            joined = await self._joined()
            if joined is None:
                raise OSError("the server is stopping, and no edge is ready")
            seen = self.playback.position if joined.incarnation == self._incarnation else None
            left, self._link = self._link, joined.link
            self._closing.append(asyncio.create_task(left.close()))  # which may take half a second
            if (there := self.playback.position) is not None and seen is not None and _leaves_out(seen, there):
                yield Notice("skipped", {"from": seen[1], "to": there[1], "reason": "moved"})
            async for event in self._told(joined.events):
                here = self.playback.position
                if isinstance(event, NewScene) and seen is not None and here is not None and here <= seen:
                    continue
                yield event

    async def close(self) -> None:
        """Leave."""
        if self._move is not None:
            self._move.cancel()
            (joined,) = await asyncio.gather(self._move, return_exceptions=True)
            if isinstance(joined, _Joined):
                await joined.link.close()
        await asyncio.gather(self._link.close(), *self._closing, return_exceptions=True)

    async def _joined(self) -> _Joined | None:
        move, self._move = self._move, None
        return None if move is None else await move

    async def _told(self, before: Iterable[Event] = ()) -> AsyncGenerator[Event, None]:
        """The events of this connection, those `before` first, until there is another one to go to."""
        edges: tuple[str, ...] = ()
        try:
            async for event in _chain(before, self._link.events):
                yield event
                if isinstance(event, Welcome):
                    edges, self._incarnation = at_edges(self.url, event.edges), event.incarnation
                if isinstance(event, Notice) and event.name == "draining" and self._move is None:
                    self._move = asyncio.create_task(_join(self._link, edges, self._options))
                if self._move is not None and self._move.done() and self._may_leave_for(self._move.result()):
                    return
        except (OSError, WebSocketException):
            if self._move is None:
                raise

    def _may_leave_for(self, joined: _Joined | None) -> bool:
        """Whether this connection has shown all up to where the next one begins, which may be ahead."""
        if joined is None:
            return False
        here, there = self.playback.position, joined.link.playback.position
        if joined.incarnation != self._incarnation or here is None or there is None:
            return True
        return here >= there


def _leaves_out(seen: tuple[int, int], there: tuple[int, int]) -> bool:
    """Whether versions of an epoch are missing between what was `seen` and where the next connection is `there`.

    They are where the old connection ended before it came that far.
    """
    return seen[0] == there[0] and there[1] > seen[1] + 1


async def _chain(before: Iterable[Event], events: AsyncGenerator[Event, None]) -> AsyncGenerator[Event, None]:
    for event in before:
        yield event
    async for event in events:
        yield event


async def _join(left: StreamLink, edges: tuple[str, ...], options: WatchOptions) -> _Joined | None:
    """A connection to the nearest edge that answers; None where none does, or it is not as far as `left` in time."""
    place = await nearest(each for each in edges if each != left.url)
    if place is None:
        return None
    link, aim = StreamLink(place, options), left.playback.position
    incarnation, told = "", list[Event]()
    newest: list[Event] = []
    try:
        async with asyncio.timeout(_MOVE_SECONDS):
            await link.open(aim if left.playback.mode == "replay" else None)
            async for event in link.events:
                if isinstance(event, NewScene):
                    newest = [event]
                else:
                    told.append(event)
                incarnation = event.incarnation if isinstance(event, Welcome) else incarnation
                here = link.playback.position
                is_level = here is not None and aim is not None and here >= aim
                if is_level or (isinstance(event, Notice) and event.name == "caught_up"):
                    return _Joined(link, incarnation, told + newest)
    except (OSError, WebSocketException, SessionError) as error:
        _log.info("%s cannot be moved to (%s)", place, error or "too slow")
    except asyncio.CancelledError:
        await link.close()
        raise
    await link.close()
    return None
