"""What a node sends, packet by packet, and what JetStream holds."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, contextmanager, suppress

from websockets.exceptions import ConnectionClosed

from streamlod.server.edge.jetstream.archive import id_of
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import Assembler, Names, parse_id
from streamlod.server.edge.jetstream.reading import Selection, read
from streamlod.server.settings import Settings
from tests.server.conftest import Running, Viewer, viewing
from tests.server.edge.processes import Node


@contextmanager
def recording(port: int, packets: list[bytes]) -> Iterator[Viewer]:
    """A viewer that asks for every packet as it was published, and decodes each; they are added to `packets`."""
    with viewing(Running(None, port, None), max_queue=None) as viewer:  # type: ignore[arg-type]
        viewer.hello(relay=True)
        ended = threading.Event()

        def run() -> None:
            with suppress(ConnectionClosed, EOFError):
                while not ended.is_set():
                    with suppress(TimeoutError):
                        message = viewer.step(0.8)  # what came is acknowledged after half a second of silence
                        if isinstance(message, bytes):
                            packets.append(message)

        with ThreadPoolExecutor(1) as thread:
            running = thread.submit(run)
            try:
                yield viewer
            finally:
                ended.set()
                running.result()


def stored(settings: Settings, stream: str = "main") -> list[tuple[str, bytes]]:
    """Every message of a stream's packets in JetStream: its id and its body, in order."""

    async def run() -> list[tuple[str, bytes]]:
        names, connection = Names(settings.jetstream.prefix), NatsConnection(settings.jetstream)
        await connection.open()
        selection = Selection(names.packets(stream), names.subject(stream, "*", "*"))
        try:
            while True:
                with suppress(OSError):  # servers that have come back agree on a leader first
                    async with aclosing(read(connection, selection, 1, None)) as messages:
                        return [(str(id_of(message)), message.data) async for message in messages]
        finally:
            await connection.close()

    return asyncio.run(asyncio.wait_for(run(), 20))


def waiting_bytes(node: Node, stream: str = "main") -> float:
    """Bytes of packets that JetStream has not acknowledged yet."""
    name = f'streamlod_outbox_bytes{{stream="{stream}"}} '
    return next(float(line[len(name) :]) for line in node.get("/metrics").text.splitlines() if line.startswith(name))


def packets_in(messages: list[tuple[str, bytes]]) -> list[bytes]:
    """The packets of these messages."""
    assembler = Assembler(1 << 24)
    found = [assembler.push(place, data) for name, data in messages if (place := parse_id(name)) is not None]
    return [packet for packet in found if packet is not None]
