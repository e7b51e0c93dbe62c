"""Messages of JetStream are read in order, whichever server of a cluster is asked."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from pathlib import Path

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.server.edge.jetstream import reading
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.reading import Selection, read
from tests.server.edge.jetstream.nats_servers import Nats, nats, needs_nats

pytestmark = needs_nats
MESSAGES = [b"%d" % number for number in range(20)]
READS = 100


def test_servers_that_have_not_heard_of_a_reader_yet_are_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One read in a hundred meets such a server."""
    monkeypatch.setattr(reading, "_SILENT_SECONDS", 15)  # three servers and this process share a machine
    with nats(tmp_path, 3) as servers:
        asyncio.run(asyncio.wait_for(_write(servers), 60))
        for number in range(3):
            found = asyncio.run(asyncio.wait_for(_read_often(servers, number), 60))
            assert found == [MESSAGES] * READS


def test_a_reader_is_asked_for_again_while_the_servers_elect_who_leads(tmp_path: Path) -> None:
    with nats(tmp_path, 3) as servers:
        asyncio.run(asyncio.wait_for(_write(servers), 60))
        leader = servers.meta_leader()
        leader.kill()
        asked = next(number for number, server in enumerate(servers.servers) if server is not leader)
        assert asyncio.run(asyncio.wait_for(_read_often(servers, asked, 1), 60)) == [MESSAGES]


async def _write(servers: Nats) -> None:
    connection = NatsConnection(servers.settings().jetstream)
    await connection.open()
    try:
        await connection.jetstream.add_stream(name="numbers", subjects=["numbers.*"], num_replicas=3)
        for message in MESSAGES:
            await connection.jetstream.publish("numbers.a", message)
        while not await _all_have_it(connection):  # a reader gets what the server has that it is made on
            await asyncio.sleep(0.05)
    finally:
        await connection.close()


async def _all_have_it(connection: NatsConnection) -> bool:
    cluster = (await connection.jetstream.stream_info("numbers")).cluster
    assert cluster is not None
    assert cluster.replicas is not None
    return all(replica.current and not replica.lag for replica in cluster.replicas)


async def _read_often(servers: Nats, number: int, times: int = READS) -> list[list[bytes]]:
    """The messages as server `number` gives them, time after time."""
    one = servers.settings().jetstream.model_copy(update={"servers": (servers.servers[number].url,)})
    connection, found = NatsConnection(one), list[list[bytes]]()
    await connection.open()
    try:
        for _ in range(times):
            async with aclosing(read(connection, Selection("numbers", "numbers.*"), 1, None)) as messages:
                found.append([message.data async for message in messages])
    finally:
        await connection.close()
    return found
