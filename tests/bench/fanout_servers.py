"""The two servers of the fan-out bench, each the main function of a process: ours, and a plain asyncio broadcast.

Both publish the same packets when they are told to over a pipe, and answer with a `Run`.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import socket
import time
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import cast

import uvloop

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.packets import binary_frame
from streamlod.server.service.app import create_app
from streamlod.server.service.run import Server, server_config
from streamlod.server.settings import Limits, Retention, Settings
from streamlod.server.worker.messages import Tag
from tests.bench.fanout_load import Run, kernel_bytes, make_packets, resident_bytes

_ACCEPT = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\nSec-WebSocket-Protocol: streamlod.v1\r\n\r\n"
)

_MAX_WAIT_SECONDS = 0.5  # s, where a viewer skipped a packet and will never have taken all bytes


class _Log(logging.Handler):
    """Keeps warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


class _Feed:
    """Publishes on command.

    Args:
        publish: gives one packet to all viewers.
        owing: whether viewers have yet to be given what was published.
        sent: bytes given to viewers so far.
        cut_off: viewers closed so far.
        transports: of all viewers.
    """

    def __init__(
        self,
        publish: Callable[[bytes], Awaitable[None]],
        owing: Callable[[], bool],
        sent: Callable[[], int],
        cut_off: Callable[[], int],
        transports: Callable[[], list[asyncio.Transport]],
    ) -> None:
        self._publish, self._owing, self._sent, self._cut_off = publish, owing, sent, cut_off
        self._transports = transports
        self._version = 0
        self._log = _Log()
        logging.getLogger("streamlod.server").addHandler(self._log)

    async def obey(self, pipe: Connection, packets: list[bytes]) -> None:
        """Answer commands (frames a second or 0 for as fast as it goes, seconds) until None comes."""
        loop = asyncio.get_running_loop()
        await self._one(packets)
        while (command := await loop.run_in_executor(None, pipe.recv)) is not None:
            pipe.send(await self._run(packets, *command))

    async def _one(self, packets: list[bytes]) -> None:
        await self._publish(packets[self._version])
        self._version += 1

    async def _run(self, packets: list[bytes], rate: float, seconds: float) -> Run:
        times: dict[int, int] = {}
        sent, cpu, begin = self._sent(), time.process_time(), time.monotonic()
        due, looking = begin, 0.0
        while time.monotonic() - begin < seconds and self._version < len(packets):
            times[self._version] = time.monotonic_ns()
            await self._one(packets)
            due += 1 / rate if rate else 0
            await asyncio.sleep(max(0.0, due - time.monotonic()) if rate else 0)
            limit = time.monotonic() + _MAX_WAIT_SECONDS
            while not rate and time.monotonic() < limit:
                looked = time.thread_time()
                busy = self._owing() or any(transport.get_write_buffer_size() for transport in self._transports())
                looking += time.thread_time() - looked
                if not busy:
                    break
                await asyncio.sleep(0.002)
        wall, cpu = time.monotonic() - begin, time.process_time() - cpu - looking
        kernel = sum(kernel_bytes(transport.get_extra_info("socket")) for transport in self._transports())
        return Run(times, cpu, wall, self._sent() - sent, resident_bytes(), kernel,
                   self._cut_off(), tuple(self._log.lines))  # fmt: skip


def serve_hub(pipe: Connection, core: int, count: int, size_bytes: int) -> None:
    """Our server; sends its port first."""
    os.sched_setaffinity(0, {core})
    packets = make_packets(count, size_bytes)
    uvloop.run(_serve_hub(pipe, packets))


async def _serve_hub(pipe: Connection, packets: list[bytes]) -> None:
    limits = Limits(viewers=4000, viewers_per_address=4000, connections=8000)
    settings = Settings(limits=limits, retention=Retention(memory_bytes=1_000_000))
    app = create_app(settings)
    registry = app.state.registry
    listener = _listener()
    server = Server(server_config(app, settings), registry)
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    stream = await registry.create(StreamSpec(play=Path("fed by the bench")))
    newest = 0

    async def publish(data: bytes) -> None:
        nonlocal newest
        newest = stream.counters.sent_bytes + len(data) * stream.viewers
        await stream.work.on_message(Tag.PACKET, data)

    feed = _Feed(
        publish,
        lambda: stream.counters.sent_bytes < newest,
        lambda: stream.counters.sent_bytes,
        lambda: stream.counters.stuck,
        lambda: [peer.transport for peer in server.server_state.connections],
    )
    await asyncio.sleep(0.2)
    gc.freeze()
    pipe.send(listener.getsockname()[1])
    await feed.obey(pipe, packets)
    server.should_exit = True
    await serving


def serve_plain(pipe: Connection, core: int, count: int, size_bytes: int) -> None:
    """A broadcast as small as asyncio allows; sends its port first."""
    os.sched_setaffinity(0, {core})
    packets = make_packets(count, size_bytes)
    uvloop.run(_serve_plain(pipe, packets))


class _Viewer(asyncio.Protocol):
    """A connection of the plain server; whatever comes after the handshake is ignored."""

    def __init__(self, viewers: set[asyncio.Transport]) -> None:
        self._viewers, self._asked = viewers, b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        if self._transport not in self._viewers:
            self._asked += data
            if b"\r\n\r\n" in self._asked:
                self._transport.write(_ACCEPT)
                self._viewers.add(self._transport)

    def connection_lost(self, _: Exception | None) -> None:
        self._viewers.discard(self._transport)


async def _serve_plain(pipe: Connection, packets: list[bytes]) -> None:
    viewers: set[asyncio.Transport] = set()
    sent = 0
    listener = _listener()
    await asyncio.get_running_loop().create_server(lambda: _Viewer(viewers), sock=listener)

    async def publish(data: bytes) -> None:
        nonlocal sent
        frame = binary_frame(data)
        for viewer in viewers:
            viewer.write(frame)
        sent += len(data) * len(viewers)

    feed = _Feed(publish, lambda: False, lambda: sent, lambda: 0, lambda: list(viewers))
    gc.freeze()
    pipe.send(listener.getsockname()[1])
    await feed.obey(pipe, packets)


def _listener() -> socket.socket:
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen(2048)
    listener.setblocking(False)
    return listener
