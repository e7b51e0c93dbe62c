"""A file that is played for nobody stands still: its packets wait for a viewer, and its worker with them."""

from __future__ import annotations

import asyncio
import time

from streamlod.server.stream.stream import Stream


class Pausing:
    """Holds the packets of one stream up while they are a file's and nobody watches or keeps them.

    Args:
        stream: whose `is_paused` tells of it.
        seconds: for which a file is played on after its last viewer has gone.
    """

    def __init__(self, stream: Stream, seconds: float) -> None:
        self._stream, self._seconds = stream, seconds
        self._free = asyncio.Event()
        self._unwatched_since = 0.0  # monotonic time
        self._is_ending = False

    def begin(self) -> None:
        """A worker starts, whether somebody watches or not."""
        self._is_ending, self._unwatched_since = False, time.monotonic()

    def end(self) -> None:
        """The worker is being ended; nothing of it is held up any more."""
        self._is_ending = True
        self._free.set()

    def join(self) -> None:
        """A viewer has come."""
        self._free.set()

    def leave(self) -> None:
        """A viewer has gone."""
        self._unwatched_since = time.monotonic()

    async def until_wanted(self) -> None:
        """Wait while nobody wants the next packet."""
        stream = self._stream
        is_wanted = stream.viewers or stream.bus.keeps or stream.bus.outbox is not None or self._is_ending
        if stream.played_file is None or stream.state != "live" or is_wanted:
            return
        if time.monotonic() - self._unwatched_since < self._seconds:
            return
        self._free.clear()
        stream.is_paused = True
        try:
            await self._free.wait()
        finally:  # also where the worker is ended meanwhile
            stream.is_paused = False
