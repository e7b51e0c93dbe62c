"""How long the picture stands still at a viewer when something happens to a server."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from itertools import pairwise

from streamlod.client.connection.watch import watch
from streamlod.client.events import NewScene

_LIMIT_SECONDS = 60.0


def longest_gap(port: int, fault: Callable[[], None], settle_seconds: float = 3.0) -> float:
    """Seconds without a new picture at a viewer, at most, from just before `fault` until so long after it."""

    async def run() -> float:
        pictures: list[float] = []

        async def look() -> None:
            async for event in watch(f"ws://127.0.0.1:{port}/v1/streams/main/live", attempts=1000):
                if isinstance(event, NewScene):
                    pictures.append(time.monotonic())

        task = asyncio.create_task(look())
        while len(pictures) < 30:
            await asyncio.sleep(0.01)
        begun = time.monotonic()
        await asyncio.to_thread(fault)
        done = time.monotonic()
        while not pictures or pictures[-1] < done + settle_seconds:
            if time.monotonic() > begun + _LIMIT_SECONDS:
                raise SystemExit(f"no pictures within {_LIMIT_SECONDS:g} s of the fault")
            await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        seen = [at for at in pictures if at > begun - 0.2]
        return max(later - earlier for earlier, later in pairwise(seen))

    return asyncio.run(run())
