"""Who starts a stream in a cluster hears whether there is room for its worker."""

from __future__ import annotations

import asyncio

from streamlod.server.settings import Settings
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.worker.placing import Placing
from streamlod.server.worker.cluster.room import Shortage


def test_who_asks_waits_for_the_end_of_the_search() -> None:
    async def run() -> None:
        stream = Stream("main", "1", Settings())
        placing = Placing(stream)
        placing.begin()
        asker = asyncio.create_task(placing.until_over(bool, is_searching=True))
        await asyncio.sleep(0)
        assert placing.is_asked
        placing.end("10.0.0.7")
        assert (await asker, stream.worker_node, placing.is_asked) == ("", "10.0.0.7", False)

    asyncio.run(run())


def test_a_refusal_is_told_until_the_next_search() -> None:
    async def run() -> None:
        stream = Stream("main", "1", Settings())
        placing = Placing(stream)
        placing.begin()
        placing.end(refused=Shortage("it needs 1 CPU", ()))
        placing.end()  # its worker is ended after that
        assert await placing.until_over(bool, is_searching=False) == "stream main: it needs 1 CPU"
        placing.begin()
        assert await placing.until_over(bool, is_searching=False) == ""

    asyncio.run(run())
