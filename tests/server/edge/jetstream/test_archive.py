"""The past after NATS lost it and was filled again: what is gone is not mistaken for something else."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import aclosing
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from nats.js.api import StreamConfig

from streamlod.core.errors import InputError
from streamlod.server.edge.jetstream.archive import Archive
from streamlod.server.edge.jetstream.bus import ArchiveBus
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import MAX_PIECE_BYTES, Names, pieces_of
from streamlod.server.edge.jetstream.reading import Selection, read
from streamlod.server.protocol.packets import Position, stream_packet
from tests.server.conftest import Clip
from tests.server.edge.jetstream.nats_servers import nats, needs_nats

pytestmark = needs_nats
INCARNATION, NAMES = "0123456789abcdef", Names("test")


async def fill(connection: NatsConnection, packets: Sequence[bytes]) -> None:
    """Make the stream and publish packets."""
    subjects = [NAMES.subject("main", "*", "*")]
    config = StreamConfig(name=NAMES.packets("main"), subjects=subjects, duplicate_window=0.5)
    await connection.jetstream.add_stream(config)
    for data in packets:
        for found, piece in pieces_of(INCARNATION, stream_packet(0, 1, data), MAX_PIECE_BYTES):
            subject = NAMES.subject("main", INCARNATION, found.kind)
            await connection.jetstream.publish(subject, piece, headers={"Nats-Msg-Id": str(found)})


def test_after_a_loss_no_address_holds_another_packet(tmp_path: Path, long_clip: Clip) -> None:
    async def run() -> None:
        connection = NatsConnection(shared.settings().jetstream)
        await connection.open()
        try:
            await fill(connection, long_clip.packets[:120])
            archive = Archive(connection, NAMES, "main", INCARNATION, 1 << 24)
            await archive.load()
            keys = [Position(1, version) for version in (0, 50, 100)]
            assert archive.keys == keys
            assert [packet.data for packet in await archive.group(keys[0])] == long_clip.packets[:50]
            place = Position(1, 20)
            assert [packet.data for packet in await archive.read(place, place)] == [long_clip.packets[20]]
            assert await archive.groups(keys[2:]) == (await archive.groups())[2:]
            with pytest.raises(InputError, match="packets one by one"):
                await ArchiveBus(100, archive).files(keys[:1])

            await connection.jetstream.delete_stream(NAMES.packets("main"))
            await fill(connection, long_clip.packets[100:260])
            for version in (20, 60, 110):
                place = Position(1, version)
                data = [packet.data for packet in await archive.read(place, place)]
                assert data in ([], [long_clip.packets[version]])
            for key in keys:
                packets = [packet.data for packet in await archive.group(key)]
                assert packets in ([], long_clip.packets[key.version : key.version + 50])
            with pytest.raises(ValueError, match="made anew"):
                await asyncio.wait_for(archive.run(), 10)
        finally:
            await connection.close()

    with nats(tmp_path) as shared:
        asyncio.run(asyncio.wait_for(run(), 30))


def test_of_a_group_that_memory_has_not_all_of_yet_no_part_is_given_away(tmp_path: Path, long_clip: Clip) -> None:
    """JetStream has the next keyframe already, so that the group counts as closed."""
    clip, key = long_clip.packets, Position(1, 50)

    async def run() -> None:
        connection = NatsConnection(shared.settings().jetstream)
        await connection.open()
        try:
            await fill(connection, clip[:120])
            archive = Archive(connection, NAMES, "main", INCARNATION, 1 << 24)
            await archive.load()
            bus = ArchiveBus(1 << 24, archive)
            for number in range(50, 98):
                bus.publish(stream_packet(number, 1, clip[number]))
            assert bus.key_after(key) is not None
            assert _data((await bus.files([key]))[key]) == clip[50:100]
        finally:
            await connection.close()

    with nats(tmp_path) as shared:
        asyncio.run(asyncio.wait_for(run(), 30))


def _data(packets: Any) -> list[bytes]:
    return [packet.data for packet in packets]


def test_reading_ends_where_what_was_to_come_is_discarded(tmp_path: Path, long_clip: Clip) -> None:
    async def run() -> None:
        connection = NatsConnection(shared.settings().jetstream)
        await connection.open()
        try:
            await fill(connection, long_clip.packets)
            for number in range(400):
                await connection.jetstream.publish(NAMES.subject("main", INCARNATION, "r"), str(number).encode())
            selection = Selection(NAMES.packets("main"), NAMES.subject("main", INCARNATION, "*"))
            seen = 0
            async with aclosing(read(connection, selection, 1, None)) as messages:
                async for _ in messages:
                    seen += 1
                    if seen == 1:
                        await connection.jetstream.purge_stream(NAMES.packets("main"))
            assert 1 <= seen < 800
        finally:
            await connection.close()

    with nats(tmp_path) as shared:
        asyncio.run(asyncio.wait_for(run(), 25))
