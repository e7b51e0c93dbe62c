"""Viewers wait for every writer of a packet, except for one that stands still."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from streamlod.server.protocol.packets import StreamPacket, stream_packet
from streamlod.server.stream.bus import Bus
from tests.server.conftest import make_clip


class Disk:
    """Writes when it is told to."""

    def __init__(self) -> None:
        self.writings: list[Future[None]] = []

    def append(self, packet: StreamPacket) -> Future[None]:
        self.writings.append(Future())
        return self.writings[-1]


class Outbox:
    """Never takes anything."""

    waiting_bytes = lost_packets = 0

    def append(self, packet: StreamPacket) -> asyncio.Future[None]:
        return asyncio.get_running_loop().create_future()


def test_while_other_servers_stand_still_viewers_wait_for_the_disk(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "clip.slod", 3, (4, 8), key_every=3)
    packets = [stream_packet(number, 1, data) for number, data in enumerate(clip.packets)]

    async def run() -> None:
        disk: Any = Disk()
        bus = Bus(1 << 20, disk)
        bus.outbox = Outbox()
        for packet in packets:
            recording = asyncio.create_task(bus.record(packet))
            await asyncio.sleep(0.1)
            assert not recording.done()
            disk.writings[-1].set_result(None)
            if packet is packets[0]:
                await recording  # once, half a second for the outbox
            await asyncio.wait_for(recording, 0.2)

    asyncio.run(run())


def test_a_disk_that_stands_still_is_waited_for_once(tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "clip.slod", 3, (4, 8), key_every=3)
    packets = [stream_packet(number, 1, data) for number, data in enumerate(clip.packets)]

    async def run() -> None:
        disk: Any = Disk()
        bus = Bus(1 << 20, disk)
        await bus.record(packets[0])
        await asyncio.wait_for(bus.record(packets[1]), 0.1)
        for writing in disk.writings:
            writing.set_result(None)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        again = asyncio.create_task(bus.record(packets[2]))
        await asyncio.sleep(0.1)
        assert not again.done()
        disk.writings[-1].set_result(None)
        await asyncio.wait_for(again, 0.2)

    asyncio.run(run())
