"""Peers that take nothing of what is written for them: their connections are cut, whatever the endpoint does.

A transport that is closed still waits for its buffer to empty, for good if the peer wants it so; an endpoint that
writes waits as well. Both hold one of the connections that the server may have.
"""

from __future__ import annotations

import asyncio
from collections import Counter

STALLED = "stalled"  # the reason under which those that were cut are counted


class StallWatch:
    """Looks at a transport's buffer every now and then, until `end`.

    Args:
        transport: what is watched.
        seconds: between two looks; it is cut when nothing left between them, though something waited.
        turned_away: counts those that were cut.
    """

    def __init__(self, transport: asyncio.Transport, seconds: float, turned_away: Counter[str]) -> None:
        self._transport, self._seconds, self._turned_away = transport, seconds, turned_away
        self._loop = asyncio.get_running_loop()
        self._left = 0  # bytes that waited at the last look, or 0 if all have gone since
        self._timer = self._loop.call_later(seconds, self._look)

    def emptied(self) -> None:
        """What waited has gone, all or nearly: what waits at the next look came later."""
        self._left = 0

    def end(self) -> None:
        """Look no more."""
        self._timer.cancel()

    def _look(self) -> None:
        left = self._transport.get_write_buffer_size()
        if 0 < self._left <= left:
            self._turned_away[STALLED] += 1
            self._transport.abort()
            return
        self._left = left
        self._timer = self._loop.call_later(self._seconds, self._look)
