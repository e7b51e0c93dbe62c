"""The websocket of capture nodes alone, served on loopback, and the way to a worker that takes their pictures."""

from __future__ import annotations

import socket
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from starlette.websockets import WebSocket

from streamlod.core.errors import InputError
from streamlod.server.http.websocket import websocket_class
from streamlod.server.ingest.push.relay import RelayedIntake
from streamlod.server.ingest.push.router import AnyIntake, push_router
from streamlod.server.settings import Limits


@contextmanager
def serving_push(open_intake: Callable[[WebSocket, str], Awaitable[AnyIntake]]) -> Iterator[int]:
    """Serve `push_router` on a free port, which is given."""
    app = FastAPI()
    app.include_router(push_router(open_intake))
    protocol = websocket_class(Limits(), Counter())
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", ws=protocol, lifespan="off"))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive()
                time.sleep(0.01)
            yield listener.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join(60)


def relayed(path: Path) -> RelayedIntake:
    """The worker's intake at `path`, once it listens; the path is there a little earlier."""
    limit = time.monotonic() + 60
    while True:
        try:
            return RelayedIntake(path)
        except InputError:
            assert time.monotonic() < limit
            time.sleep(0.02)
