"""Packets in pieces, and together again."""

from __future__ import annotations

import pytest

from streamlod.server.edge.jetstream.messages import MAX_PIECE_BYTES, Assembler, parse_id, pieces_of
from streamlod.server.protocol.packets import StreamPacket, stream_packet
from tests.server.conftest import Clip

INCARNATION = "0123456789abcdef"
MAX_BYTES = 16 << 20


def large(clip: Clip, size: int) -> StreamPacket:
    """A packet of `size` bytes; what it holds does not matter here."""
    packet = stream_packet(0, 1, clip.packets[0])
    return StreamPacket(0, packet.position, packet.info, bytes(range(256)) * (size // 256), 0.0)


def test_a_packet_of_sixteen_mebibytes_survives(clip: Clip) -> None:
    packet, assembler = large(clip, MAX_BYTES), Assembler(MAX_BYTES)
    pieces = list(pieces_of(INCARNATION, packet, MAX_PIECE_BYTES))
    assert len(pieces) == 32
    done = [assembler.push(found, data) for found, data in pieces]
    assert done[:-1] == [None] * 31
    assert done[-1] == packet.data


def test_nothing_comes_of_a_packet_without_its_middle_or_its_end(clip: Clip) -> None:
    packet, assembler = large(clip, 4 * MAX_PIECE_BYTES), Assembler(MAX_BYTES)
    pieces = list(pieces_of(INCARNATION, packet, MAX_PIECE_BYTES))
    assert [assembler.push(*pieces[number]) for number in (0, 1, 3, 2)] == [None] * 4
    assert [assembler.push(*each) for each in pieces[:3]] == [None] * 3
    small = stream_packet(1, 1, clip.packets[1])  # the publisher was killed, and another one goes on
    assert [assembler.push(*each) for each in pieces_of(INCARNATION, small, MAX_PIECE_BYTES)] == [small.data]
    assert assembler.push(*pieces[3]) is None


def test_a_message_that_is_stored_twice_counts_once(clip: Clip) -> None:
    packet, assembler = large(clip, 2 * MAX_PIECE_BYTES), Assembler(MAX_BYTES)
    pieces = list(pieces_of(INCARNATION, packet, MAX_PIECE_BYTES))
    done = [assembler.push(*pieces[number]) for number in (0, 0, 1, 1)]
    assert done == [None, None, packet.data, None]


def test_a_packet_beyond_the_limit_is_left_out(clip: Clip) -> None:
    packet, assembler = large(clip, 2 * MAX_PIECE_BYTES), Assembler(MAX_PIECE_BYTES)
    assert [assembler.push(*each) for each in pieces_of(INCARNATION, packet, MAX_PIECE_BYTES)] == [None, None]


def test_ids_are_read_as_they_were_written(clip: Clip) -> None:
    for found, _ in pieces_of(INCARNATION, large(clip, 2 * MAX_PIECE_BYTES), MAX_PIECE_BYTES):
        assert parse_id(str(found)) == found


@pytest.mark.parametrize(
    "text",
    ["", "main/1/2/k/0/1", f"{INCARNATION}/1/2/k/1/1", f"{INCARNATION}/1/2/x/0/1", f"{INCARNATION}/-1/2/k/0/1",
     f"{INCARNATION}/1/2/k/0/1/", f"{INCARNATION}/1/2/k/0/99999"],
)  # fmt: skip
def test_other_ids_are_none(text: str) -> None:
    assert parse_id(text) is None
