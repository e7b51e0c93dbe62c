"""Broadcast to viewers that are up to date, and what takes a viewer out of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from streamlod.codec.encoder import encode_keyframe
from streamlod.server.protocol.packets import (
    PIECE_BYTES,
    BinaryMessage,
    Position,
    StreamPacket,
    binary_frame,
    stream_packet,
)
from streamlod.server.settings import Limits
from streamlod.server.stream.broadcast import Broadcast, Receiver
from streamlod.server.stream.counters import Counters
from streamlod.server.stream.hub import Hub
from streamlod.server.viewer.delivery import Delivery
from streamlod.server.viewer.playhead import Playhead
from tests.codec.scenes import make_scene


@pytest.fixture(scope="module")
def packet() -> StreamPacket:
    return stream_packet(0, 1, encode_keyframe(make_scene((3, 10, 20)), time_ns=0, profile=0))


class Viewer:
    """Takes `room` frames, then blocks."""

    def __init__(self, broadcast: Broadcast, levels: int, room: int = 10) -> None:
        self.broadcast, self.room = broadcast, room
        self.frames: list[bytes] = []
        self.receiver = Receiver(self.write, self.leave)
        broadcast.add(self.receiver, levels)

    def write(self, frame: bytes) -> None:
        self.frames.append(frame)
        if len(self.frames) >= self.room:
            self.leave()

    def leave(self) -> None:
        if self.receiver.levels:
            self.broadcast.remove(self.receiver)


def test_all_share_one_frame_a_level_count_and_one_that_blocks_does_not_keep_the_others(packet: StreamPacket) -> None:
    counters = Counters()
    broadcast = Broadcast(counters)
    broadcast.send(packet)  # so that its number of levels is nothing new
    blocking, *others = [Viewer(broadcast, 3, room=1), Viewer(broadcast, 3), Viewer(broadcast, 1)]
    for _ in range(2):
        broadcast.send(packet)
    assert blocking.frames == [binary_frame(packet.data)]
    assert [len(viewer.frames) for viewer in others] == [2, 2]
    assert others[0].frames[0] is blocking.frames[0]
    assert others[1].frames == [binary_frame(packet.restricted(1))] * 2
    sizes = [viewer.receiver.sent for viewer in (blocking, *others)]
    assert sizes == [len(packet.data), 2 * len(packet.data), 2 * len(packet.restricted(1))]
    assert counters.sent_bytes == sum(sizes)


def test_a_receiver_leaves_above_its_send_limit_and_when_the_number_of_levels_changes(packet: StreamPacket) -> None:
    broadcast = Broadcast(Counters())
    viewer = Viewer(broadcast, 2)
    broadcast.send(packet, b"news")  # three levels where there were none
    assert viewer.receiver.levels == 0
    assert viewer.frames[0].endswith(b"news")
    broadcast.add(viewer.receiver, 2)
    viewer.receiver.send_limit = viewer.receiver.sent
    for _ in range(3):
        broadcast.send(packet)
    assert len(viewer.frames) == 2


def test_pieces_of_a_keyframe_are_made_once_and_make_up_one_message(packet: StreamPacket) -> None:
    large = replace(packet, data=packet.data + bytes(2 * PIECE_BYTES), _messages={})
    pieces = large.message(3).pieces
    assert pieces is large.message(3).pieces
    assert [piece[0] for piece in pieces] == [0x02, *[0x00] * (len(pieces) - 2), 0x80]
    heads = [4] * (len(pieces) - 1) + [2 if len(pieces[-1]) < 128 else 4]
    assert b"".join(piece[head:] for head, piece in zip(heads, pieces, strict=True)) == large.data
    large.forget_messages()
    assert large.message(3).pieces is not pieces


class Nowhere:
    """A connection that takes everything."""

    @property
    def is_clear(self) -> bool:
        return True

    async def binary(self, message: BinaryMessage, interval_seconds: float | None = None) -> None: ...

    async def text(self, message: str) -> None: ...

    def post(self, frame: bytes) -> None: ...

    def on_blocked(self, call: object) -> None: ...


def test_a_viewer_whose_packets_take_long_gets_nothing_until_it_has_them_all() -> None:
    counters = Counters()
    delivery = Delivery(Nowhere(), Hub(10**6, counters), counters, Limits(flight_bytes=100_000), None, lambda: None)
    delivery.receiver.sent = 10**6
    fine = [delivery.can_post]  # it has never acknowledged anything: nothing is known of it
    for sent, received, now in (
        (1_000_000, 950_000, 100.0),
        (1_040_000, 1_000_000, 101.0),  # what was sent at 100 s took a second
        (1_200_000, 1_050_000, 103.0),  # too many bytes
        (1_200_000, 1_190_000, 104.5),
        (1_200_000, 1_195_000, 105.5),
        (1_200_000, 1_199_000, 108.0),  # few bytes, but they take long
        (1_200_000, 1_200_000, 109.0),
    ):
        delivery.receiver.sent = sent
        delivery.acknowledge(received, now)
        fine.append(delivery.can_post)
    assert fine == [True, True, True, False, True, True, False, True]


def test_a_playhead_is_clamped_to_the_window_and_stands_where_it_was_paused() -> None:
    oldest, newest = Position(1, 5), Position(2, 9)
    playhead = Playhead(Position(1, 2))
    assert playhead.settle(None, oldest, newest) == (oldest, True)
    assert playhead.mode == "replay"
    playhead.pause()
    here = Position(1, 8)
    assert playhead.settle(here, oldest, newest) == (here, False)
    playhead.play(here)
    assert (playhead.mode, playhead.settle(here, oldest, newest)) == ("replay", (here, False))
    playhead.seek(Position(7, 0))
    assert playhead.settle(here, oldest, newest) == (newest, True)
    assert playhead.mode == "live"
    playhead.play(here)  # it plays already
    assert not playhead.changed
