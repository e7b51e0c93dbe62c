"""The window of recent packets keeps to its memory, whatever the packets' size."""

from __future__ import annotations

import tracemalloc

from streamlod.server.protocol.packets import PacketWindow, stream_packet
from tests.server.conftest import Clip

_MAX_BYTES = 400_000


def test_small_packets_take_no_more_memory_than_is_allowed(clip: Clip) -> None:
    key = clip.packets[0]
    window, sequence = PacketWindow(_MAX_BYTES), 0
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for epoch in range(20):
            for packet in (key, *clip.packets[1:50]):
                window.append(stream_packet(sequence, epoch, bytes(bytearray(packet))).without_messages())
                sequence += 1
        taken = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert 100 < len(window.packets) < sequence  # whole groups were dropped
    assert taken < 1.3 * _MAX_BYTES
