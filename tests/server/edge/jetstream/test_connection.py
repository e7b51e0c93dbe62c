"""The connection to a NATS that takes connections and then says nothing, as one does whose process is stopped."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest

from streamlod.server.edge.jetstream import connection as module
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.settings import JetStreamSettings

pytest.importorskip("nats")
ATTEMPTS = 4


class SilentNats:
    """Answers the first client, then hangs up; later ones hear nothing."""

    def __init__(self) -> None:
        self.came, self.left = 0, 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.came += 1
        with suppress(OSError):
            if self.came == 1:
                writer.write(b'INFO {"server_id": "it", "version": "2.11.0", "max_payload": 1048576}\r\n')
                await reader.readuntil(b"PING\r\n")
                writer.write(b"PONG\r\n")
            else:
                await reader.read()  # until the client hangs up
        self.left += 1
        writer.close()


def test_each_failed_attempt_closes_its_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else an open socket is left behind by each, several times a minute for as long as NATS is away."""
    monkeypatch.setattr(module, "_CONNECT_SECONDS", 0.1)
    monkeypatch.setattr(module, "_RECONNECT_SECONDS", 0.05)

    async def run() -> None:
        nats = SilentNats()
        server = await asyncio.start_server(nats.serve, "127.0.0.1", 0)
        async with server, asyncio.timeout(60):
            port = server.sockets[0].getsockname()[1]
            connection = NatsConnection(JetStreamSettings(servers=(f"nats://127.0.0.1:{port}",)))
            await connection.open()
            try:
                while nats.came < 1 + ATTEMPTS or nats.left < nats.came - 1:  # all but the one that is being tried
                    await asyncio.sleep(0.01)
            finally:
                await connection.close()
            while nats.left < nats.came:
                await asyncio.sleep(0.01)

    asyncio.run(run())
