"""Cuts connections whose peer reads nothing of what is written to it.

A transport that is being closed waits for its write buffer to drain, for ever if the peer never reads; so does an
endpoint that writes. Both occupy one of the connections that the server may have.
"""

from __future__ import annotations

import asyncio
from collections import Counter

STALLED = "stalled"  # the reason under which those that were cut are counted


class StallWatch:
    """Checks a transport's write buffer at intervals, until `end`.

    Args:
        transport: what is watched.
        seconds: between two checks; the connection is cut when bytes were waiting and none was sent in between.
        turned_away: counts the connections that were cut.
    """

    def __init__(self, transport: asyncio.Transport, seconds: float, turned_away: Counter[str]) -> None:
        self._transport, self._seconds, self._turned_away = transport, seconds, turned_away
        self._loop = asyncio.get_running_loop()
        self._left = 0  # bytes waiting at the last check, or 0 if the buffer has drained since
        self._timer = self._loop.call_later(seconds, self._look)

    def emptied(self) -> None:
        """The write buffer has drained."""
        self._left = 0

    def end(self) -> None:
        """Stop checking."""
        self._timer.cancel()

    def _look(self) -> None:
        left = self._transport.get_write_buffer_size()
        if 0 < self._left <= left:
            self._turned_away[STALLED] += 1
            self._transport.abort()
            return
        self._left = left
        self._timer = self._loop.call_later(self._seconds, self._look)
