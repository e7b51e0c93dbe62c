"""The websocket's lower end on real sockets: waiting for a peer that takes nothing, a little, or everything."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest
from websockets.frames import Frame, Opcode

from streamlod.server.http.websocket import Connection
from streamlod.server.protocol.packets import binary_frame, text_frame

_STUCK_SECONDS = 1.2  # a pause of this process that is longer looks like a peer that takes nothing


class Peer(asyncio.Protocol):
    """What `Connection` needs of a websocket's protocol."""

    def __init__(self) -> None:
        self.writable = asyncio.Event()
        self.writable.set()
        self.disconnected = self.close_sent = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def pause_writing(self) -> None:
        self.writable.clear()

    def resume_writing(self) -> None:
        self.writable.set()


async def connected() -> tuple[Connection, Peer, socket.socket]:
    here, there = socket.socketpair()
    there.setblocking(False)
    loop = asyncio.get_running_loop()
    _, peer = await loop.create_connection(Peer, sock=here)
    protocol: Any = peer
    return Connection(protocol), peer, there


async def until_cut(connection: Connection, peer: Peer, there: socket.socket, taken_bytes: int) -> float:
    """Seconds until `drain` gives up, while the peer takes so much every 200 ms and pings are added to what waits."""
    loop = asyncio.get_running_loop()

    async def meanwhile() -> None:
        for _ in range(40):
            await asyncio.sleep(0.2)
            transport: Any = peer.transport
            transport.write(b"\x89\x00")
            if taken_bytes:
                there.recv(taken_bytes)

    begin, task = loop.time(), asyncio.create_task(meanwhile())
    try:
        await connection.drain(_STUCK_SECONDS)
    except TimeoutError:
        return loop.time() - begin
    finally:
        task.cancel()
    return float("inf")


def test_a_peer_that_takes_nothing_is_given_up_though_pings_are_added() -> None:
    async def run() -> float:
        connection, peer, there = await connected()
        connection.post(b"small")
        assert connection.is_clear
        connection.post(bytes(4_000_000))
        assert not connection.is_clear
        seconds = await until_cut(connection, peer, there, 0)
        connection.abort()
        there.close()
        return seconds

    assert _STUCK_SECONDS <= asyncio.run(run()) < 10


@pytest.mark.long
def test_a_peer_that_takes_a_little_is_waited_for() -> None:
    async def run() -> float:
        connection, peer, there = await connected()
        connection.post(bytes(3_000_000))
        seconds = await until_cut(connection, peer, there, 200_000)
        connection.abort()
        there.close()
        return seconds

    assert asyncio.run(run()) > 2.5 * _STUCK_SECONDS


def test_the_way_to_a_connection_that_closes_is_not_clear() -> None:
    async def run() -> None:
        connection, peer, there = await connected()
        transport: Any = peer.transport
        transport.close()
        assert not connection.is_clear
        there.close()
        await asyncio.sleep(0)

    asyncio.run(run())


@pytest.mark.parametrize("text", ["", "x" * 125, "ä" * 100, "x" * 70_000])
def test_frames_are_those_of_the_websocket_standard(text: str) -> None:
    assert text_frame(text) == Frame(Opcode.TEXT, text.encode()).serialize(mask=False)
    assert binary_frame(text.encode()) == Frame(Opcode.BINARY, text.encode()).serialize(mask=False)
