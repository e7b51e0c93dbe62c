"""Packets that one server sends to another directly, over a real NATS server."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from nats.aio.client import Client
from nats.aio.msg import Msg

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream import live, live_packets
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.live import LiveSender
from streamlod.server.edge.jetstream.live_reading import LiveReader
from streamlod.server.edge.jetstream.messages import MSG_ID, Names, pieces_of
from streamlod.server.protocol.packets import Place, Position, StreamPacket, stream_packet
from streamlod.server.settings import JetStreamSettings
from streamlod.server.stream.bus import RECORD_SECONDS
from tests.server.conftest import Clip
from tests.server.edge.jetstream.nats_servers import nats, needs_nats

pytestmark = needs_nats
INCARNATION, OTHER = "0123456789abcdef", "fedcba9876543210"
SUBJECTS = Names("streamlod").live("main", INCARNATION)
PACKET_BYTES = 1 << 20


@dataclass(slots=True)
class Way:
    """A sender, and what has come to a reader."""

    sender: LiveSender
    reader: LiveReader
    received: list[bytes]
    publishing: NatsConnection
    may_send: asyncio.Event

    def append(self, *packets: StreamPacket) -> None:
        """These wait for JetStream."""
        for packet in packets:
            self.sender.append(packet)

    def store(self, *packets: StreamPacket) -> None:
        """JetStream takes each of these at once."""
        for packet in packets:
            self.sender.append(packet)
            self.sender.packets.store()

    def ask(self, held: Place | None) -> Coroutine[Any, Any, None]:
        """As a reader that has not asked yet."""
        return LiveReader(self.publishing, SUBJECTS, INCARNATION, PACKET_BYTES).ask(held)

    async def until(self, done: Callable[[], bool]) -> None:
        async with asyncio.timeout(5):
            while not done():
                await asyncio.sleep(0.01)


@asynccontextmanager
async def way(settings: JetStreamSettings) -> AsyncIterator[Way]:
    ends = [NatsConnection(settings), NatsConnection(settings)]
    for connection in ends:
        await connection.open()
    may_send = asyncio.Event()
    may_send.set()
    found = Way(
        LiveSender(ends[0], SUBJECTS, INCARNATION, may_send),
        LiveReader(ends[1], SUBJECTS, INCARNATION, PACKET_BYTES),
        [], ends[0], may_send,
    )  # fmt: skip

    async def read() -> None:
        async for packet in found.reader.packets():
            found.received.append(packet.data)

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


def test_packets_are_sent_once_they_have_waited_too_long(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets = [replace(packet, arrived=0.0) for packet in numbered(long_clip)]  # they took long to decode
            pair.store(*packets[:10])
            await asyncio.sleep(RECORD_SECONDS + 0.2)
            assert pair.received == []

            begun = time.monotonic()
            pair.append(*packets[10:15])
            await pair.until(lambda: bool(pair.received))
            assert time.monotonic() - begun >= RECORD_SECONDS
            await pair.until(lambda: len(pair.received) == 15)
            assert pair.received == long_clip.packets[:15]  # those stored just before may have reached no reader

            pair.append(packets[15])
            await pair.until(lambda: len(pair.received) == 16)
            for _ in range(6):
                pair.sender.packets.store()
            monkeypatch.setattr(
                live_packets, "_RECENT_SECONDS", -1.0
            )  # what is stored from now on has reached everybody
            pair.store(*packets[16:20])
            pair.append(*packets[20:22])
            await pair.until(lambda: len(pair.received) == 18)
            assert pair.received[16:] == long_clip.packets[20:22]

    with nats(tmp_path) as shared:
        run(test())


def test_the_time_in_which_nothing_could_be_stored_does_not_count(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            pair.may_send.clear()
            pair.append(*numbered(long_clip)[:10])
            await asyncio.sleep(0.1)
            monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + 100))
            pair.may_send.set()
            await asyncio.sleep(0.3)
            assert pair.received == []

    monkeypatch.setattr(live, "RECORD_SECONDS", 20.0)
    with nats(tmp_path) as shared:
        run(test())


def test_a_reader_gets_what_it_asks_for(tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes behind the packet that it holds, and then each that follows, for some time."""

    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets, data = numbered(long_clip), long_clip.packets
            pair.store(*packets[:60])
            await pair.ask((Position(1, 50), False))  # the keyframe there has not come
            await pair.until(lambda: len(pair.received) == 10)
            pair.store(*packets[60:70])
            await pair.until(lambda: len(pair.received) == 20)
            assert pair.received == data[50:70]
            await pair.ask((Position(1, 69), False))  # it has everything
            await pair.ask(None)  # sent once more, from a keyframe on
            await pair.until(lambda: len(pair.received) == 90)
            assert pair.received[20:] == data[:70]
            pair.sender._wanted_until = 0.0
            pair.store(*packets[70:80])
            await asyncio.sleep(0.2)
            assert len(pair.received) == 90

    monkeypatch.setattr(live, "_WANTED_SECONDS", 20.0)
    monkeypatch.setattr(live, "_AGAIN_SECONDS", 0.0)
    with nats(tmp_path) as shared:
        run(test())


def test_of_too_much_only_the_newest_group_is_sent(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            pair.append(*numbered(long_clip)[:120])
            await pair.until(lambda: len(pair.received) == 20)
            assert pair.received == long_clip.packets[100:120]

    monkeypatch.setattr(live_packets, "_MAX_BYTES", sum(map(len, long_clip.packets[:120])) - 1)
    with nats(tmp_path) as shared:
        run(test())


def test_only_the_server_that_publishes_the_stream_sends(tmp_path: Path, long_clip: Clip) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            pair.may_send.clear()
            pair.append(*numbered(long_clip)[:10])
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
            pair.append(*packets[:10])
            pair.sender.packets.clear()
            pair.append(*packets[50:60])
            await pair.until(lambda: len(pair.received) == 10)
            assert pair.received == long_clip.packets[50:60]

    with nats(tmp_path) as shared:
        run(test())


def test_a_reader_that_wants_nothing_keeps_nothing_from_others(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            pair.append(*numbered(long_clip)[:40])
            await pair.until(lambda: len(pair.received) == 40)
            await pair.ask((Position(1, 39), False))
            await pair.ask((Position(1, 20), False))
            await pair.until(lambda: len(pair.received) == 59)
            assert pair.received[40:] == long_clip.packets[21:40]
            await pair.ask((Position(1, 20), False))
            await asyncio.sleep(0.1)
            assert len(pair.received) == 59  # not again so soon

    monkeypatch.setattr(live, "_AGAIN_SECONDS", 20.0)
    with nats(tmp_path) as shared:
        run(test())


def test_who_holds_something_old_gets_what_begins_with_a_keyframe(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = Position(0, 900), False

    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packets, data = numbered(long_clip), long_clip.packets
            monkeypatch.setattr(live_packets, "_RECENT_SECONDS", -1.0)
            pair.store(*packets[:20])
            monkeypatch.setattr(live_packets, "_RECENT_SECONDS", 20.0)
            pair.store(*packets[20:40])
            await pair.ask(old)  # residuals only
            await pair.ask((Position(1, 19), False))  # they follow what this one holds
            await pair.until(lambda: len(pair.received) == 20)
            assert pair.received == data[20:40]
            pair.store(*packets[40:60])
            await pair.until(lambda: len(pair.received) == 40)
            await pair.ask(old)
            await pair.until(lambda: len(pair.received) == 50)
            assert pair.received[20:] == data[40:60] + data[50:60]
            monkeypatch.setattr(live_packets, "_MAX_BYTES", sum(map(len, data[50:60])))
            await pair.ask((Position(1, 19), False))  # of too much only the newest group
            await pair.until(lambda: len(pair.received) == 60)
            assert pair.received[50:] == data[50:60]
            monkeypatch.setattr(live_packets, "_MAX_BYTES", len(data[50]))
            await pair.ask((Position(1, 19), False))
            await asyncio.sleep(0.1)
            assert len(pair.received) == 60

    monkeypatch.setattr(live, "_AGAIN_SECONDS", -1.0)
    with nats(tmp_path) as shared:
        run(test())


def test_what_happens_while_packets_are_being_sent_counts(
    tmp_path: Path, long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader asks, and later all packets are left out."""

    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            client, sent = pair.publishing.client, list[bytes]()

            async def publish(subject: str, data: bytes, headers: dict[str, str]) -> None:
                await Client.publish(client, subject, data, headers=headers)
                sent.append(data)
                if len(sent) == 8:
                    await pair.sender._answer(Msg(client, data=b""))
                if len(sent) == 15:
                    pair.sender.packets.clear()

            monkeypatch.setattr(client, "publish", publish)
            pair.append(*numbered(long_clip)[:12])
            await pair.until(lambda: len(pair.received) == 15)
            await asyncio.sleep(0.1)
            assert pair.received == sent == long_clip.packets[:8] + long_clip.packets[:7]

    with nats(tmp_path) as shared:
        run(test())


def test_a_packet_that_is_sent_twice_comes_twice(tmp_path: Path, long_clip: Clip) -> None:
    async def test() -> None:
        async with way(shared.settings().jetstream) as pair:
            packet = numbered(long_clip)[0]
            ((found, data),) = pieces_of(INCARNATION, packet, 1 << 20)
            for _ in range(2):
                await pair.publishing.client.publish(SUBJECTS.packets, data, headers={MSG_ID: str(found)})
            await pair.until(lambda: len(pair.received) == 2)
            assert pair.received == [packet.data, packet.data]

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
            assert pair.publishing.fault == ""
            await pair.publishing.client.publish("denied", b"")
            await pair.until(lambda: "denied" in pair.publishing.fault)

    deny = '{deny: ["streamlod.live.>", "denied"]}'
    user = f"{{user: server, password: none, permissions: {{publish: {deny}, subscribe: {deny}}}}}"
    with nats(tmp_path, more=f"authorization {{users: [{user}]}}\nno_auth_user: server\n") as shared:
        run(test())
    refused = [line for line in caplog.messages if "ermissions" in line and "denied" not in line]
    assert len(refused) == len(set(refused)) == 4  # to publish and to listen, at either end
