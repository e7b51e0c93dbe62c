"""The websocket of capture nodes alone, served on loopback."""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager

import uvicorn
from fastapi import FastAPI
from starlette.websockets import WebSocket

from server.ingest.push.router import AnyIntake, push_router
from tests.server.ingest.rig import free_ports


@contextmanager
def serving_push(open_intake: Callable[[WebSocket, str], Awaitable[AnyIntake]]) -> Iterator[int]:
    """Serve `push_router` on a free port, which is given."""
    app = FastAPI()
    app.include_router(push_router(open_intake))
    (port,) = free_ports(1)
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="error", ws="websockets-sansio", lifespan="off"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield port
    server.should_exit = True
    thread.join(10)
