"""The folder in which recordings lie, the one thread that writes there, and the room that is left."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from streamlod.server.settings import Retention

_T = TypeVar("_T")


class Disk:
    """Holds recordings.

    Attributes:
        streams: folder with a folder for each stream.
        retention: what to keep.
    """

    def __init__(self, streams: Path, retention: Retention) -> None:
        self.streams, self.retention = streams, retention
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="recording")

    @property
    def has_room(self) -> bool:
        """Whether there is more left than the reserve."""
        usage = shutil.disk_usage(self.streams)
        return usage.free > usage.total * self.retention.reserve_fraction

    async def run(self, work: Callable[[], _T]) -> _T:
        """Do `work` on the writing thread, and wait for it."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def submit(self, work: Callable[[], None]) -> Future[None]:
        """Do `work` on the writing thread, later."""
        return self._thread.submit(work)

    def close(self) -> None:
        """Finish queued work."""
        self._thread.shutdown(wait=True)
