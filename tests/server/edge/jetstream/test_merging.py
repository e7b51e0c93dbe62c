"""Packets that come by two ways reach a stream's viewers once and in order."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.codec.encoder import encode_keyframe, encode_residual
from streamlod.core.errors import BitstreamError
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import difference
from streamlod.server.edge.jetstream import merging
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import Directory
from streamlod.server.edge.jetstream.merging import Merger
from streamlod.server.edge.jetstream.messages import LivePacket, Names
from streamlod.server.edge.jetstream.supply import ArchivedStream
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.stream import EdgeStream
from streamlod.server.protocol.packets import Position, stream_packet
from streamlod.server.settings import Settings
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.traces import Traces
from tests.codec.scenes import assert_same_state, make_scene, move
from tests.server.conftest import Clip


def edge_stream() -> EdgeStream:
    """A stream whose packets the tests hand on in place of a pull."""
    settings, names = Settings(), Names("test")
    described = OriginStream(
        id="main", incarnation="0123456789abcdef", source="data", state="live", created_at=datetime.now(UTC)
    )
    connection = NatsConnection(settings.jetstream)
    supply = ArchivedStream(connection, names, Directory(connection, names, settings), settings, described)
    return EdgeStream(described, supply, settings, Feed(), Traces(), 1.0, lambda _: None, lambda _: None)


def taken(stream: EdgeStream) -> list[bytes]:
    return [packet.data for packet in stream.hub.window.packets]


def retained(stream: EdgeStream) -> list[list[bytes]]:
    return [[packet.data for packet in group] for group in stream.bus.window.groups()]


def direct(packets: list[bytes], number: int, epoch: int = 1) -> LivePacket:
    """One of these as it is sent directly."""
    place, *before = (stream_packet(0, epoch, packets[at]).place for at in (number, number - 1) if at >= 0)
    return LivePacket(place, before[0] if before else None, packets[number])


def renewed() -> tuple[list[bytes], Scene]:
    """Packets of which the fourth is a keyframe of another state, at the position of the third; the last state."""
    states = [make_scene((10, 40))]
    for version in (1, 2):
        states.append(move(states[-1], seed=version))
    other = make_scene((10, 40), seed=5)
    key = Scene(other.header, other.weights, other.levels, 2, 2)
    last = move(key, seed=3)
    packets = [encode_keyframe(states[0], time_ns=0, profile=0)]
    packets += [encode_residual(a, difference(a, b), time_ns=0, profile=0) for a, b in pairwise(states)]
    packets += [
        encode_keyframe(key, time_ns=0, profile=0),
        encode_residual(key, difference(key, last), time_ns=0, profile=0),
    ]
    return packets, last


@pytest.mark.parametrize("seed", range(8))
def test_each_is_handed_on_once_and_in_order(long_clip: Clip, seed: int) -> None:
    """JetStream has every packet, late; the other way is ahead, loses some and repeats some."""
    chance, packets, stream = random.Random(seed), long_clip.packets[:150], edge_stream()

    async def run() -> None:
        merger, stored, live = Merger(stream, 1), 0, 0
        while stored < len(packets):
            if live < len(packets) and (live <= stored or chance.random() < 0.6):
                if chance.random() < 0.9:
                    await merger.take_live(direct(packets, live))
                live = max(0, live - 10) if chance.random() < 0.05 else live + 1
            else:
                await merger.take(1, packets[stored])
                stored += 1

    asyncio.run(run())
    assert taken(stream) == packets
    assert retained(stream) == [packets[:50], packets[50:100], packets[100:]]


def test_a_keyframe_at_the_position_of_the_residual_before_it_is_a_packet_of_its_own() -> None:
    packets, last = renewed()
    stream = edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for data in packets[:2]:
            await merger.take(1, data)
        assert await merger.take_live(direct(packets, 2)) == "taken"
        assert await merger.take_live(direct(packets, 4)) == "gap"  # the keyframe was missed, which only decoding shows
        await merger.take(1, packets[2])
        assert await merger.take_live(direct(packets, 3)) == "taken"
        assert await merger.take_live(direct(packets, 2)) == "known"
        await merger.take(1, packets[3])
        await merger.take(1, packets[4])
        assert await merger.take_live(direct(packets, 4)) == "known"

    asyncio.run(run())
    assert taken(stream) == packets
    assert stream.hub.scene is not None
    assert_same_state(stream.hub.scene, last)


@pytest.mark.parametrize("at", [0, 10, -1])
def test_a_damaged_one_that_came_directly_does_no_harm(long_clip: Clip, at: int) -> None:
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        await merger.take(1, packets[0])
        for number in range(1, 53):  # over the keyframe at 50
            damaged = bytearray(packets[number])
            damaged[at] ^= 0x55
            assert await merger.take_live(replace(direct(packets, number), data=bytes(damaged))) == "gap"
            assert await merger.take_live(replace(direct(packets, number), data=packets[number][:-5])) == "gap"
            assert taken(stream) == packets[:number]
            await merger.take(1, packets[number])
        with pytest.raises(BitstreamError):
            await merger.take(1, packets[53][:-5])  # JetStream's own

    asyncio.run(run())
    assert taken(stream) == packets[:53]


def test_over_a_gap_it_waits_and_then_goes_on_with_a_keyframe(long_clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for data in packets[:60]:
            await merger.take(1, data)
        for number in (62, 100):
            assert await merger.take_live(direct(packets, number)) == "gap"
        assert await merger.take_live(direct(packets, 60)) == "taken"
        monkeypatch.setattr(merging, "_MISSED_SECONDS", 0.0)
        for number in (62, 99):
            assert await merger.take_live(direct(packets, number)) == "gap"
        for number in (100, 101):
            assert await merger.take_live(direct(packets, number)) == "taken"
        for data in packets[60:103]:  # JetStream has what was missed, too late for viewers at the live edge
            await merger.take(1, data)

    asyncio.run(run())
    assert taken(stream) == packets[:61] + packets[100:103]
    assert retained(stream) == [packets[100:103]]  # the past has no holes


def test_the_next_epoch_follows_what_was_never_stored(long_clip: Clip) -> None:
    """A publisher that was killed had sent the last packets directly only; it begins again behind what was stored."""
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for data in packets[:20]:
            await merger.take(1, data)
        for number in range(20, 25):
            assert await merger.take_live(direct(packets, number)) == "taken"
        for data in packets[50:53]:
            await merger.take(2, data)
        assert await merger.take_live(direct(packets, 25)) == "known"

    asyncio.run(run())
    assert taken(stream) == packets[:25] + packets[50:53]
    assert stream.newest == Position(2, 52)
    assert retained(stream) == [packets[50:53]]


def test_what_was_missed_before_a_keyframe_of_the_same_position_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    packets, _ = renewed()

    async def run(stream: EdgeStream, outcome: str) -> None:
        merger = Merger(stream, 1)
        for data in packets[:2]:
            await merger.take(1, data)
        assert await merger.take_live(direct(packets, 3)) == outcome
        for data in packets[2:]:
            await merger.take(1, data)

    stream = edge_stream()
    asyncio.run(run(stream, "gap"))
    assert retained(stream) == [packets[:3], packets[3:]]
    monkeypatch.setattr(merging, "_MISSED_SECONDS", 0.0)
    late = edge_stream()
    asyncio.run(run(late, "taken"))
    assert retained(late) == [packets[3:]]


def test_the_next_epoch_waits_for_what_was_missed_of_the_one_before(
    long_clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for data in packets[:20]:
            await merger.take(1, data)
        first = replace(direct(packets, 50, 2), after=direct(packets, 21).place)
        assert await merger.take_live(first) == "gap"
        assert await merger.take_live(replace(first, after=None)) == "gap"
        for number in (20, 21):
            assert await merger.take_live(direct(packets, number)) == "taken"
        assert await merger.take_live(first) == "taken"
        assert retained(stream) == [packets[:22], packets[50:51]]
        monkeypatch.setattr(merging, "_MISSED_SECONDS", 0.0)
        assert await merger.take_live(replace(direct(packets, 100, 3), after=direct(packets, 51, 2).place)) == "taken"

    asyncio.run(run())
    assert retained(stream) == [packets[100:101]]


def test_what_jetstream_does_not_have_is_not_waited_for(long_clip: Clip) -> None:
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for data in [*packets[:10], *packets[11:13], *packets[50:52]]:
            await merger.take(1, data)

    asyncio.run(run())
    assert taken(stream) == packets[:10] + packets[50:52]
    assert retained(stream) == [packets[50:52]]


def test_what_is_of_no_epoch_that_can_come_now_does_no_harm(long_clip: Clip) -> None:
    packets, stream = long_clip.packets, edge_stream()

    async def run() -> None:
        merger = Merger(stream, 1)
        for epoch in (0, 3, 4_000_000_000, 9_999_999_999):
            assert await merger.take_live(direct(packets, 0, epoch)) == "gap"
        for number in range(3):
            await merger.take(1, packets[number])
            for epoch in (3, 4_000_000_000, 9_999_999_999):
                other = replace(direct(packets, 50, epoch), after=merger.held)
                assert await merger.take_live(other) == "gap"
        other = replace(direct(packets, 50), place=direct(packets, 3).place, after=merger.held)
        assert await merger.take_live(other) == "gap"
        for number in range(3, 60):
            await merger.take(1, packets[number])

    asyncio.run(run())
    assert taken(stream) == packets[:60]
