"""The search for room in a cluster, and those who wait to be told of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress

from streamlod.server.stream.stream import Stream
from streamlod.server.worker.cluster.room import Shortage

_PLACING_SECONDS = 20.0  # that a start waits for room in a cluster, most of them for a local process to load Ray


class Placing:
    """Room for the workers of one stream, which look for it one after the other.

    Args:
        stream: whose `worker_node` tells of it.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._over = asyncio.Event()
        self._askers = 0
        self._refused: Shortage | None = None

    @property
    def is_asked(self) -> bool:
        """Whether somebody waits to be told."""
        return self._askers > 0

    def begin(self) -> None:
        """A worker looks for room."""
        self._over.clear()
        self._refused = None

    def end(self, node: str = "", refused: Shortage | None = None) -> None:
        """The worker has room on a node, or looks for none any more, perhaps as it is refused; who waits is told."""
        self._stream.worker_node, self._refused = node, refused or self._refused
        self._over.set()

    async def until_over(self, may_see: Callable[[str], bool], *, is_searching: bool) -> str:
        """Wait until the search is over if there is one, some seconds at most.

        Returns why there is no room, for somebody who may see such streams, and then it has failed; otherwise nothing.
        """
        if is_searching:
            self._askers += 1
            try:
                with suppress(TimeoutError):
                    async with asyncio.timeout(_PLACING_SECONDS):
                        await self._over.wait()
            finally:
                self._askers -= 1
        return f"stream {self._stream.id}: {self._refused.sentence(may_see)}" if self._refused else ""
