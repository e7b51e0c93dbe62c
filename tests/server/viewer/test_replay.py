"""Going back into the past: in small portions, also where the past goes away meanwhile; and the hub beside that."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from streamlod.codec.mp4.sound import is_piece, pack_piece, read_piece
from streamlod.core.errors import SessionError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.messages import parse_control
from streamlod.server.protocol.packets import BinaryMessage, Position, StreamPacket, stream_packet
from streamlod.server.settings import Limits, Settings
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.hub import Hub
from streamlod.server.stream.sound_track import SoundTrack
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.viewer.delivery import Delivery
from streamlod.server.viewer.follower import Follower
from streamlod.server.viewer.pacing import LevelControl
from streamlod.server.viewer.replay import Replay
from streamlod.server.viewer.sound import SoundSender
from tests.server.conftest import Clip, kept_from, make_clip, running, viewing
from tests.server.sounds import pieces


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_clip(tmp_path_factory.mktemp("small") / "scene.slod", 60, counts=(5, 10), key_every=50)


class ForgetfulBus(Bus):
    """Notes how much is read at once; forgets the first group of pictures after so many readings."""

    def __init__(self, clip: Clip, forget_after: int = -1) -> None:
        super().__init__(10**7)
        self.read_sizes: list[int] = []
        self._forget_after = forget_after
        for number, data in enumerate(clip.packets):
            self.publish(stream_packet(number, 1, data))

    async def read(self, first: Position, last: Position) -> list[StreamPacket]:
        packets = await super().read(first, last)
        self.read_sizes.append(len(packets))
        if len(self.read_sizes) == self._forget_after:
            self.window = kept_from(self.window, Position(1, 50))
        return packets


class Screen:
    """A transport that takes everything."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None:
        self.packets.append(message.data)

    async def text(self, message: str) -> None: ...

    def post(self, frame: bytes) -> None: ...

    @property
    def is_clear(self) -> bool:
        return True

    def on_blocked(self, call: object) -> None: ...


def replaying(bus: Bus) -> tuple[Replay, Delivery, Screen]:
    counters, screen = Counters(), Screen()
    delivery = Delivery(screen, Hub(10**6, counters), counters, Limits(), None, lambda: None)
    return Replay(bus, delivery, LevelControl(64, 64, quiet_since=0.0)), delivery, screen


def test_the_way_to_a_place_is_read_in_portions(small: Clip) -> None:
    bus = ForgetfulBus(small)
    replay, delivery, screen = replaying(bus)
    asyncio.run(replay.load(Position(1, 45)))
    assert screen.packets == small.packets[:46]
    assert delivery.position == Position(1, 45)
    assert max(bus.read_sizes) <= 16


def test_what_leaves_the_window_on_the_way_ends_it_where_it_still_decodes(small: Clip) -> None:
    replay, _, screen = replaying(ForgetfulBus(small, forget_after=2))
    asyncio.run(replay.load(Position(1, 45)))
    assert screen.packets == small.packets[:32]
    asyncio.run(replay.step(time.monotonic()))
    assert not asyncio.run(replay.step(time.monotonic())), "what comes after a gap waits as long as the gap was"
    asyncio.run(replay.step(time.monotonic() + 60))
    assert screen.packets[32:] == [small.packets[50]]


def test_a_new_viewer_whose_past_is_gone_joins_at_the_live_edge(small: Clip) -> None:
    replay, delivery, screen = replaying(Bus(10**7))
    asyncio.run(replay.load(Position(1, 5)))
    asyncio.run(replay.step(0.0))
    assert replay.is_over
    assert screen.packets == []
    stream = WorkerStream(StreamSpec(play=Path("nothing.slod")), Settings())
    follower = Follower(stream, delivery, LevelControl(64, 64, quiet_since=0.0), Limits())
    follower.resume()
    stream.hub.send(asyncio.run(stream.hub.decode(stream_packet(0, 1, small.packets[0]))))
    asyncio.run(follower.step(0.0))
    assert delivery.position == Position(1, 0)


def test_new_packets_are_taken_while_viewers_keep_the_shared_threads_busy(small: Clip) -> None:
    async def run() -> StreamPacket | None:
        loop, over, hub = asyncio.get_running_loop(), threading.Event(), Hub(10**6, Counters())
        loop.set_default_executor(ThreadPoolExecutor(2))
        reading = [asyncio.create_task(asyncio.to_thread(over.wait, 20)) for _ in range(4)]
        await asyncio.sleep(0)
        try:
            async with asyncio.timeout(10):
                hub.send(await hub.decode(stream_packet(0, 1, small.packets[0])))
        finally:
            over.set()
            await asyncio.gather(*reading)
        return hub.newest

    newest = asyncio.run(run())
    assert newest is not None
    assert newest.position == Position(1, 0)


def test_frames_that_were_filmed_far_apart_are_replayed_far_apart(small: Clip) -> None:
    """A stream that trains one frame in eight seconds: the pace is that of filming, whatever the gap."""
    bus, gap_ns = Bus(10**7), 8 * 10**9
    for number, data in enumerate(small.packets[:4]):
        packet = stream_packet(number, 1, data)
        bus.publish(replace(packet, info=replace(packet.info, time_ns=number * gap_ns)))
    replay, _, screen = replaying(bus)
    before = time.monotonic()
    asyncio.run(replay.load(Position(1, 0)))
    after = time.monotonic()
    asyncio.run(replay.step(after))
    wait = replay.seconds_to_next(after)
    assert wait is not None
    assert 8.0 - (after - before) <= wait <= 8.0
    assert not asyncio.run(replay.step(after + wait - 0.1))
    assert asyncio.run(replay.step(after + wait + 0.001))
    assert len(screen.packets) == 2


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_nobody_waits_where_nothing_was_filmed(small: Clip, speed: float) -> None:
    """Phones that were away for ten minutes: the picture before stays for ten seconds of filming, sound leaps there."""
    bus, gap_ns = Bus(10**7), 600 * 10**9
    for number, data in enumerate(small.packets[:4]):
        packet = stream_packet(number, 1, data)
        bus.publish(replace(packet, info=replace(packet.info, time_ns=number * gap_ns)))
    replay, _, screen = replaying(bus)
    replay.speed = speed
    asyncio.run(replay.load(Position(1, 0)))
    now = time.monotonic()
    for count in (2, 3):
        while asyncio.run(replay.step(now)):
            pass
        assert replay.seconds_to_next(now) == pytest.approx(10 / speed)
        assert replay.played_ns(now) == pytest.approx((count - 1) * gap_ns - 10e9)
        now += 10 / speed + 0.001
        assert asyncio.run(replay.step(now))
        assert len(screen.packets) == count


def test_sound_leaps_over_what_nobody_waits_for(small: Clip) -> None:
    """What was heard meanwhile is not sent: a viewer would get minutes of sound at once."""
    track = SoundTrack()
    for piece in pieces(40.0):
        track.add(pack_piece(piece))
    _, delivery, screen = replaying(Bus(10**7))
    sound = SoundSender(track, delivery, lambda: None)
    sound.want(True)

    async def play() -> None:
        packet = stream_packet(0, 1, small.packets[0])
        await delivery.send(BinaryMessage(packet.restricted(64)), packet)
        for played in (0, 30 * 10**9):
            while await sound.step(played):
                pass

    asyncio.run(play())
    begins = [read_piece(data).begin_ns / 1e9 for data in screen.packets if is_piece(data)]
    assert [begin for begin in begins if 4.0 < begin < 27.0] == []
    assert begins[0] <= 0.0
    assert 33.0 < begins[-1] < 34.0


def test_a_new_epoch_follows_at_once_whatever_its_times_say(small: Clip) -> None:
    bus = Bus(10**7)
    bus.publish(stream_packet(0, 1, small.packets[0]))
    later = stream_packet(1, 2, small.packets[0])
    bus.publish(replace(later, info=replace(later.info, time_ns=3600 * 10**9)))
    replay, _, screen = replaying(bus)
    asyncio.run(replay.load(Position(1, 0)))
    asyncio.run(replay.step(time.monotonic()))
    assert replay.seconds_to_next(time.monotonic()) == 0.0
    assert asyncio.run(replay.step(time.monotonic()))
    assert len(screen.packets) == 2


def test_the_past_can_be_played_faster_and_slower(small: Clip) -> None:
    """Eight seconds of filming last two at four times the speed, also where the speed changes half-way."""
    bus, gap_ns = Bus(10**7), 8 * 10**9
    for number, data in enumerate(small.packets[:4]):
        packet = stream_packet(number, 1, data)
        bus.publish(replace(packet, info=replace(packet.info, time_ns=number * gap_ns)))
    replay, _, _ = replaying(bus)
    asyncio.run(replay.load(Position(1, 0)))
    begin = time.monotonic()
    asyncio.run(replay.step(begin))
    first = replay.seconds_to_next(begin)
    assert first is not None
    replay.play_at(4, begin + first - 4)
    assert replay.seconds_to_next(begin + first - 4) == pytest.approx(1)
    replay.play_at(0.5, begin + first - 4)
    assert replay.seconds_to_next(begin + first - 4) == pytest.approx(8)


@pytest.mark.parametrize("speed", [0, -1, 9, True, "2", None])
def test_nonsense_as_speed_is_refused(speed: object) -> None:
    with pytest.raises(SessionError, match="speed must be a number"):
        parse_control(json.dumps({"type": "set", "speed": speed}))


def test_who_is_paused_hears_how_far_behind_they_fall(slow_clip: Clip) -> None:
    """The window goes on growing for them, and is told with the time at which its newest was filmed."""
    with running(Settings(), StreamSpec(play=slow_clip.path)) as server, viewing(server) as viewer:
        viewer.hello()
        viewer.until_version(1)
        viewer.send(type="pause")
        viewer.until("position")
        at = max(viewer.decoder.versions)
        told = [viewer.until("window")["newest_time_ns"] for _ in range(4)]
        assert sorted(set(told)) == told
        assert max(viewer.decoder.versions) - at < 4, "and gets no frames"
