"""Packets that one server sends to another directly, over a real NATS server."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from server.edge.ending import end
from server.edge.jetstream import live
from server.edge.jetstream.connection import NatsConnection
from server.edge.jetstream.live import LiveSender
from server.edge.jetstream.live_reading import LiveReader
from server.edge.jetstream.messages import MSG_ID, Names, pieces_of
from server.protocol.packets import Position, StreamPacket, stream_packet
from server.settings import JetStreamSettings
from server.stream.bus import RECORD_SECONDS
from tests.server.conftest import Clip
from tests.server.edge.jetstream.nats_servers import nats, needs_nats

pytestmark = needs_nats
INCARNATION, OTHER = "0123456789abcdef", "fedcba9876543210"
SUBJECTS = Names("test").live("main", INCARNATION)
PACKET_BYTES = 1 << 20


@dataclass(slots=True)
class Way:
    """A sender, what waits for JetStream there, and what has come to a reader."""

    sender: LiveSender
    reader: LiveReader
    waiting: list[StreamPacket]
    received: list[bytes]
    publishing: NatsConnection
    may_send: asyncio.Event

    def append(self, packet: StreamPacket) -> None:
        self.waiting.append(packet)
        self.sender.append(packet)

    async def until(self, done: Callable[[], bool]) -> None:
        async with asyncio.timeout(5):
            while not done():
                await asyncio.sleep(0.01)


@asynccontextmanager
async def way(settings: JetStreamSettings) -> AsyncIterator[Way]:
    ends = [NatsConnection(settings), NatsConnection(settings)]
    for connection in ends:
        await connection.open()
    may_send, waiting = asyncio.Event(), list[StreamPacket]()
    may_send.set()
    oldest: Callable[[], StreamPacket | None] = lambda: waiting[0] if waiting else None  # noqa: E731
    found = Way(
        LiveSender(ends[0], SUBJECTS, INCARNATION, may_send, oldest),
        LiveReader(ends[1], SUBJECTS, INCARNATION, PACKET_BYTES),
        waiting, [], ends[0], may_send,
    )  # fmt: skip

    async def read() -> None:
        async for _, data in found.reader.packets():
            found.received.append(data)

    tasks: list[asyncio.Task[None]] = [asyncio.create_task(work) for work in (found.sender.run(), read())]
    await asyncio.sleep(0.1)
    for connection in ends:
        await connection.client.flush()  # NATS knows by now who listens
    try:
        yield found
    finally:
        await end(*tasks)
        for connection in ends:
            await connection.close()


def run(test: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(test, 20))


def numbered(clip: Clip) -> list[StreamPacket]:
    """The clip's packets as if they had all come just now."""
    return [stream_packet(number, 1, data) for number, data in enumerate(clip.packets)]


def test_packets_are_sent_once_they_have_waited_too_long(tmp_path: Path, long_clip: Clip) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets = numbered(long_clip)
            for packet in packets[:10]:  # each is stored at once
                pair.append(packet)
                pair.waiting.clear()
            await asyncio.sleep(RECORD_SECONDS + 0.2)
            assert pair.received == []

            begun = time.monotonic()
            packets[10:] = [replace(packet, arrived=begun) for packet in packets[10:]]
            for packet in packets[10:15]:
                pair.append(packet)
            await pair.until(lambda: bool(pair.received))
            assert time.monotonic() - begun >= RECORD_SECONDS
            await pair.until(lambda: len(pair.received) == 15)
            assert pair.received == long_clip.packets[:15]  # those stored just before may have reached no reader

            pair.append(packets[15])
            await pair.until(lambda: len(pair.received) == 16)
            pair.waiting.clear()
            pair.append(replace(packets[16], arrived=time.monotonic()))
            pair.waiting.clear()
            await asyncio.sleep(RECORD_SECONDS + 0.2)
            assert len(pair.received) == 16

    with nats(tmp_path) as shared:
        run(test())


def test_a_reader_gets_what_it_asks_for(tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes behind the packet that it holds, and then each that follows, for some time."""

    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets, data = numbered(long_clip), long_clip.packets

            def store(first: int, last: int) -> None:
                for packet in packets[first:last]:
                    pair.append(packet)
                    pair.waiting.clear()

            store(0, 60)
            await pair.reader.ask((Position(1, 50), False))  # the keyframe there has not come
            await pair.until(lambda: len(pair.received) == 10)
            store(60, 70)
            await pair.until(lambda: len(pair.received) == 20)
            assert pair.received == data[50:70]
            await asyncio.sleep(0.7)  # a reader asks no more often
            await pair.reader.ask((Position(1, 69), False))
            await asyncio.sleep(0.7)
            assert pair.received == data[50:70]
            await pair.reader.ask(None)
            await pair.until(lambda: len(pair.received) == 90)
            assert pair.received[20:] == data[:70]
            await asyncio.sleep(live._WANTED_SECONDS + 0.1)
            store(70, 80)
            await asyncio.sleep(0.2)
            assert len(pair.received) == 90

    monkeypatch.setattr(live, "_WANTED_SECONDS", 1.0)
    with nats(tmp_path) as shared:
        run(test())


def test_of_too_much_only_the_newest_group_is_sent(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            for packet in numbered(long_clip)[:120]:
                pair.append(packet)
            await pair.until(lambda: len(pair.received) == 20)
            assert pair.received == long_clip.packets[100:120]

    monkeypatch.setattr(live, "_MAX_BYTES", sum(map(len, long_clip.packets[:120])) - 1)
    with nats(tmp_path) as shared:
        run(test())


def test_only_the_server_that_publishes_the_stream_sends(tmp_path: Path, long_clip: Clip) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            pair.may_send.clear()
            for packet in numbered(long_clip)[:10]:
                pair.append(packet)
            await pair.reader.ask(None)
            await asyncio.sleep(RECORD_SECONDS + 0.2)
            assert pair.received == []
            pair.may_send.set()
            await pair.until(lambda: len(pair.received) == 10)

    with nats(tmp_path) as shared:
        run(test())


def test_what_was_left_out_of_jetstream_is_not_sent(tmp_path: Path, long_clip: Clip) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets = numbered(long_clip)
            for packet in packets[:10]:
                pair.append(packet)
            pair.waiting.clear()
            pair.sender.clear()
            for packet in packets[50:60]:
                pair.append(packet)
            await pair.until(lambda: len(pair.received) == 10)
            assert pair.received == long_clip.packets[50:60]

    with nats(tmp_path) as shared:
        run(test())


def test_whatever_else_comes_is_left_out(tmp_path: Path, long_clip: Clip) -> None:
    """Packets of another incarnation, those that lack a piece, and what is none."""

    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets, client = numbered(long_clip), pair.publishing.client

            async def publish(incarnation: str, packet: StreamPacket, *, without: int = -1) -> None:
                pieces = list(pieces_of(incarnation, packet, 1 + len(packet.data) // 3))
                assert len(pieces) == 3
                for found, data in pieces:
                    if found.piece != without:
                        await client.publish(SUBJECTS.packets, data, headers={MSG_ID: str(found)})

            await publish(OTHER, packets[0])
            await publish(INCARNATION, packets[1], without=1)
            await client.publish(SUBJECTS.packets, b"no packet", headers={MSG_ID: "no id"})
            await client.publish(SUBJECTS.packets, b"")
            await publish(INCARNATION, packets[2], without=2)
            await publish(INCARNATION, packets[3])
            await pair.until(lambda: bool(pair.received))
            assert pair.received == [long_clip.packets[3]]

    with nats(tmp_path) as shared:
        run(test())


def test_a_user_who_may_not_loses_this_way_only(
    tmp_path: Path, long_clip: Clip, caplog: pytest.LogCaptureFixture
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            for packet in numbered(long_clip)[:100]:
                pair.append(packet)
                await pair.reader.ask(None)
            await asyncio.sleep(RECORD_SECONDS + 0.5)
            assert pair.received == []
            await pair.publishing.jetstream.add_stream(name="other", subjects=["other"])
            assert (await pair.publishing.jetstream.publish("other", b"")).seq == 1

    deny = '{deny: ["test.live.>"]}'
    user = f"{{user: server, password: none, permissions: {{publish: {deny}, subscribe: {deny}}}}}"
    with nats(tmp_path, more=f"authorization {{users: [{user}]}}\nno_auth_user: server\n") as shared:
        run(test())
    refused = [line for line in caplog.messages if "ermissions" in line]
    assert len(refused) == len(set(refused)) == 4  # to publish and to listen, at either end
