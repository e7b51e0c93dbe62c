"""Capture nodes: who may push pictures into a stream, and where they go."""

from __future__ import annotations

import asyncio

from starlette.websockets import WebSocket

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError
from streamlod.server.api.access import admit, until_withdrawn
from streamlod.server.auth.gate import Right
from streamlod.server.http.websocket import CONNECTION, Connection
from streamlod.server.ingest.push.message import MAX_MESSAGE_BYTES
from streamlod.server.ingest.push.relay import RelayedIntake
from streamlod.server.ingest.push.router import push_router


async def open_intake(websocket: WebSocket, stream_id: str) -> RelayedIntake:
    """The way to the worker that trains the stream.

    Raises:
        SessionError: the node may not push there, or nobody takes pictures there at present.
    """
    stream = await admit(websocket, Right.PUBLISH, stream_id)
    if stream.push_socket is None:
        raise SessionError(CloseCode.FORBIDDEN, "this stream takes no pictures: it is not made from live cameras")
    try:
        intake = await asyncio.to_thread(RelayedIntake, stream.push_socket)
    except InputError as error:
        raise SessionError(CloseCode.BUSY, "the stream takes no pictures at present; try again later") from error
    connection: Connection = websocket.scope[CONNECTION]
    connection.allow_messages_of(MAX_MESSAGE_BYTES)
    return intake


async def until_no_publisher(websocket: WebSocket, stream_id: str) -> None:
    """Wait until the node may not push there any more; SessionError then."""
    await until_withdrawn(websocket, Right.PUBLISH, stream_id)


router = push_router(open_intake, until_no_publisher)
