"""A server beside a rig that films before anything is trained: its only stream waits, and its rig runs elsewhere.

Phones push to it, and its page shows what all cameras see.
"""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.server.api.push import capture_address, scope_of
from streamlod.server.api.registry import Registry
from streamlod.server.pipeline.job import TrainJob
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.addresses import found_at
from streamlod.server.service.app import create_app
from streamlod.server.service.run import Server, bind, certificates_of, server_config
from streamlod.server.settings import Settings

STREAM = "main"  # as `serve --live` calls its stream, so that phones go on when that takes over
_LINK_SECONDS = 24 * 3600
_START_SECONDS = 60.0


@dataclass(frozen=True, slots=True)
class Station:
    """A running server: its address for phones, where a rig takes what they push, and where the rig is shown."""

    registry: Registry
    address: str
    loop: asyncio.AbstractEventLoop

    @property
    def push_socket(self) -> Path:
        """Where the rig listens."""
        found = self.registry.streams[STREAM].push_socket
        assert found is not None
        return found

    @property
    def overview(self) -> str:
        """Address of the page that shows what all cameras see."""
        return f"{self.address}/cameras"

    def show(self, figures: dict[str, Any], pictures: dict[str, bytes]) -> None:
        """Have the server tell figures of the rig and show small pictures of its cameras; from any thread.

        Args:
            figures: `Statistics` as a mapping.
            pictures: JPEG files by camera.
        """
        stream = self.registry.streams[STREAM]

        def take() -> None:
            stream.ingest, stream.camera_pictures = figures, pictures

        with suppress(RuntimeError):  # the server has ended
            self.loop.call_soon_threadsafe(take)

    def pages(self, cameras: Sequence[str]) -> dict[str, str]:
        """Addresses of the page that films, by camera; where nobody needs a token, one for all, by an empty name.

        They are good for a day, and for servers that follow this one with the same `link_key`, which trains the rig.
        """
        gate, expires = self.registry.gate, int(time.time()) + _LINK_SECONDS
        if gate.is_open:
            return {"": f"{self.address}/capture"}
        queries = {name: gate.links.sign(scope_of(STREAM, name), expires, "") for name in cameras}
        return {name: self.address + capture_address(STREAM, name, query) for name, query in queries.items()}


@contextmanager
def station(settings: Settings, rig: Path) -> Iterator[Station]:
    """Serve the stream `main` of a rig's file to phones while the context lasts; nothing is kept of it.

    Raises:
        InputError: settings that cannot be used, or an address in use.
    """
    settings.check()
    settings = settings.model_copy(update={"state": None, "streams": (), "edge": None})
    app = create_app(settings)
    registry: Registry = app.state.registry
    listener = bind(settings.host, settings.port)
    server = Server(server_config(app, settings), registry, certificates_of(settings))
    loops: list[asyncio.AbstractEventLoop] = []

    async def run() -> None:
        loops.append(asyncio.get_running_loop())
        await _run(server, listener, rig)

    thread = threading.Thread(target=lambda: asyncio.run(run()), name="station")
    thread.start()
    try:
        limit = time.monotonic() + _START_SECONDS
        while STREAM not in registry.streams:
            if not thread.is_alive() or time.monotonic() > limit:
                raise InputError("server", "does not start; see the log")
            time.sleep(0.02)
        yield Station(registry, found_at(listener, is_tls=settings.certificate is not None), loops[0])
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


async def _run(server: Server, listener: socket.socket, rig: Path) -> None:
    registry: Registry = server.config.app.state.registry  # type: ignore[union-attr]
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.02)
    if server.started:
        await registry.create(StreamSpec(STREAM, TrainJob(live=rig)), start=False)
    await serving
    for connection in list(server.server_state.connections):  # whose requests were cancelled
        if connection.transport is not None:
            connection.transport.abort()
    await asyncio.sleep(0)
