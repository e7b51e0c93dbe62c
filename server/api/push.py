"""Capture nodes: who may push pictures into a stream, and where they go."""

from __future__ import annotations

import asyncio
from typing import Any
from urllib.parse import urlencode

from starlette.websockets import WebSocket

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError
from streamlod.server.api.access import LINK_ENDED, RECHECK_SECONDS, admit, is_signed, registry_of, until_withdrawn
from streamlod.server.api.registry import STOPPING
from streamlod.server.auth.gate import Right
from streamlod.server.http.websocket import CONNECTION, Connection
from streamlod.server.ingest.push.message import MAX_MESSAGE_BYTES, PushMessage
from streamlod.server.ingest.push.relay import RelayedIntake
from streamlod.server.ingest.push.router import AnyIntake, push_router


def scope_of(stream_id: str, camera: str) -> str:
    """The text that a link for one camera of a stream is signed for.

    No path, because links for all downloads of a stream open every path below it.
    """
    return f"publish {stream_id} {camera}"


def capture_address(stream_id: str, camera: str, query: str) -> str:
    """The page on which a phone films as one camera; `query` is its signature, empty where none is needed."""
    fields = urlencode({"stream": stream_id, "camera": camera})
    return f"/capture?{fields}&{query}" if query else f"/capture?{fields}"


class _OneCamera:
    """An intake of which a signed link opens one camera only."""

    def __init__(self, intake: AnyIntake, camera: str) -> None:
        self._intake, self._camera = intake, camera

    def accept(self, message: PushMessage) -> None:
        """See `Intake.accept`."""
        if message.camera != self._camera:
            raise InputError(f"camera {message.camera}", f"is not the one of this link, {self._camera}")
        self._intake.accept(message)

    def wanted(self) -> dict[str, Any]:
        """See `Intake.wanted`."""
        found = self._intake.wanted()
        return found | {"cameras": [each for each in found["cameras"] if each["name"] == self._camera]}

    def close(self) -> None:
        """See `Intake.close`."""
        self._intake.close()


async def open_intake(websocket: WebSocket, stream_id: str) -> AnyIntake:
    """The way to the worker that trains the stream.

    Raises:
        SessionError: the node may not push there, or nobody takes pictures there at present.
    """
    linked, camera = _linked_camera(websocket, stream_id), websocket.query_params.get("camera", "")
    links = registry_of(websocket).gate.links
    if linked is None and links.has_ended(scope_of(stream_id, camera), websocket.query_params):
        raise SessionError(CloseCode.UNAUTHORISED, LINK_ENDED)
    stream = await admit(websocket, Right.PUBLISH, stream_id, signed=linked is not None)
    if stream.push_socket is None:
        raise SessionError(CloseCode.FORBIDDEN, "this stream takes no pictures: it is not made from live cameras")
    try:
        intake = await asyncio.to_thread(RelayedIntake, stream.push_socket)
    except InputError as error:
        raise SessionError(CloseCode.BUSY, "the stream takes no pictures at present; try again later") from error
    session, publishers = asyncio.current_task(), registry_of(websocket).publishers
    assert session is not None
    publishers.add(session)
    session.add_done_callback(publishers.discard)
    connection: Connection = websocket.scope[CONNECTION]
    connection.allow_messages_of(MAX_MESSAGE_BYTES)
    return intake if linked is None else _OneCamera(intake, linked)


async def until_no_publisher(websocket: WebSocket, stream_id: str) -> None:
    """Wait until the node may not push there any more; SessionError then."""
    if _linked_camera(websocket, stream_id) is None:
        await until_withdrawn(websocket, Right.PUBLISH, stream_id)
    while _linked_camera(websocket, stream_id) is not None:
        await asyncio.sleep(RECHECK_SECONDS)
    raise SessionError(CloseCode.UNAUTHORISED, LINK_ENDED)


async def until_stopping(websocket: WebSocket, _: str) -> None:
    """Wait until the server stops; SessionError then."""
    await registry_of(websocket).stopping.wait()
    raise SessionError(CloseCode.STOPPING, STOPPING)


def _linked_camera(websocket: WebSocket, stream_id: str) -> str | None:
    """The camera for which the address is signed, or none."""
    camera = websocket.query_params.get("camera")
    return camera if camera and is_signed(websocket, scope_of(stream_id, camera), stream_id) else None


router = push_router(open_intake, until_no_publisher, until_stopping)
