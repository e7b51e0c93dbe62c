"""A stream that is followed from JetStream, where packets of it are missing or stored twice."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from pathlib import Path

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import Directory
from streamlod.server.edge.jetstream.messages import MAX_PIECE_BYTES, pieces_of
from streamlod.server.edge.jetstream.supply import ArchivedStream
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.stream import EdgeStream
from streamlod.server.protocol.packets import stream_packet
from streamlod.server.settings import Settings
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.traces import Traces
from tests.server.conftest import Clip
from tests.server.edge.jetstream.nats_servers import nats, needs_nats
from tests.server.edge.jetstream.test_archive import INCARNATION, NAMES, fill

pytestmark = needs_nats


def edge_stream(connection: NatsConnection) -> tuple[EdgeStream, ArchivedStream]:
    """A stream, and the supply of its packets."""
    settings = Settings()
    described = OriginStream(
        id="main", incarnation=INCARNATION, source="data", state="live", created_at=datetime.now(UTC)
    )
    supply = ArchivedStream(connection, NAMES, Directory(connection, NAMES, settings), settings, described)
    return EdgeStream(described, supply, settings, Feed(), Traces(), 1.0, lambda _: None, lambda _: None), supply


async def store_again(connection: NatsConnection, data: bytes) -> None:
    """Publish a packet until JetStream has forgotten that it has it."""
    ((found, piece),) = pieces_of(INCARNATION, stream_packet(0, 1, data), MAX_PIECE_BYTES)
    subject, headers = NAMES.subject("main", INCARNATION, found.kind), {"Nats-Msg-Id": str(found)}
    while (await connection.jetstream.publish(subject, piece, headers=headers)).duplicate:
        await asyncio.sleep(0.02)


def test_each_packet_is_taken_once_and_behind_a_gap_from_the_next_keyframe_on(tmp_path: Path, long_clip: Clip) -> None:
    clip = long_clip.packets
    kept = [*clip[:20], *clip[50:60]]

    async def run() -> None:
        connection = NatsConnection(shared.settings().jetstream)
        await connection.open()
        try:
            await fill(connection, clip[:20])
            await store_again(connection, clip[10])
            await fill(connection, [*clip[23:30], *clip[50:60]])
            stream, supply = edge_stream(connection)
            following = asyncio.create_task(supply._follow(stream.messages))
            while [packet.data for packet in stream.hub.window.packets] != kept:
                await asyncio.sleep(0.02)
            await end(following)
            groups = [[packet.data for packet in group] for group in stream.bus.window.groups()]
            assert groups == [clip[50:60]]  # the group with a hole is not given away as a whole one
        finally:
            await connection.close()

    with nats(tmp_path) as shared:
        asyncio.run(asyncio.wait_for(run(), 30))
