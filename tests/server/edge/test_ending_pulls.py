"""An edge that stops waits for the pulls of streams that have gone, whose connections are still being closed."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from datetime import UTC, datetime

from streamlod.server.api.registry import Registry
from streamlod.server.edge.edge import Edge
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.origin_messages import OriginMessages
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Bus


class SlowToEnd:
    """A source of one stream, which is deleted in the end; whoever pulls it takes a while to close the connection."""

    name = origin_name = "test"

    def __init__(self) -> None:
        self.bus = Bus(1 << 20)
        self.listed = [
            OriginStream(
                id="a", incarnation="0123456789abcdef", source="data", state="live", created_at=datetime.now(UTC)
            )
        ]
        self.pulling = self.closed = False

    async def streams(self) -> list[OriginStream]:
        return self.listed

    async def edges(self) -> tuple[str, ...]:
        return ()

    def supply(self, stream: OriginStream) -> SlowToEnd:
        return self

    async def pull(self, taker: OriginMessages) -> None:
        self.pulling = True
        try:
            await asyncio.sleep(60)
        finally:
            await asyncio.sleep(0.2)
            self.closed = True


def test_it_waits_for_them() -> None:
    async def run() -> None:
        source, registry = SlowToEnd(), Registry(Settings())
        task = asyncio.create_task(Edge(registry, source, poll_seconds=0.01, linger_seconds=60).run())
        while "a" not in registry.streams:
            await asyncio.sleep(0.01)
        registry.streams["a"].join()
        while not source.pulling:
            await asyncio.sleep(0.01)
        source.listed = []
        while registry.streams:
            await asyncio.sleep(0.01)
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        assert source.closed
        await registry.drain()

    asyncio.run(run())
