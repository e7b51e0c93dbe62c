"""The websocket of capture nodes: each picture is acknowledged, or refused with a reason."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

from fastapi import APIRouter
from starlette.types import Message
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.utils import ClientDisconnected

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError
from streamlod.server.ingest.push.message import PUSH_SUBPROTOCOL, PushMessage, parse_push
from streamlod.server.ingest.push.questions import answer as answer_question

_LOG = logging.getLogger(__name__)
_MAX_REASON_BYTES = 123  # bytes, RFC 6455 section 5.5
_MAX_SILENCE_SECONDS = 60.0  # between two pictures; a node that is silent for longer is closed with 1013


class AnyIntake(Protocol):
    """An `Intake` here, or a `RelayedIntake` to a worker."""

    def accept(self, message: PushMessage) -> None:
        """Take a picture; InputError if it is refused."""

    def wanted(self) -> dict[str, Any]:
        """The rig's rate and the cameras that are pushed to it, see `Intake.wanted`."""

    def close(self) -> None:
        """The capture node has gone."""


def push_router(
    open_intake: Callable[[WebSocket, str], Awaitable[AnyIntake]],
    *ends: Callable[[WebSocket, str], Coroutine[Any, Any, None]],
) -> APIRouter:
    """The route ``/v1/streams/{stream_id}/ingest``.

    Args:
        open_intake: given the request and the stream's id, checks the right to publish and gives what takes the
            pictures; raises SessionError to refuse.
        ends: each waits until no pictures are taken from there any more, and then raises SessionError.
    """
    router = APIRouter()

    @router.websocket("/v1/streams/{stream_id}/ingest")
    async def push(websocket: WebSocket, stream_id: str) -> None:
        """A capture node of docs/ingest.md."""
        offers = websocket.scope.get("subprotocols", [])
        try:
            try:
                if PUSH_SUBPROTOCOL not in offers:
                    raise SessionError(CloseCode.BAD_VERSION, f"offer the sub-protocol {PUSH_SUBPROTOCOL}")
                intake = await open_intake(websocket, stream_id)
            except SessionError:  # close codes and reasons need a connection
                await websocket.accept(PUSH_SUBPROTOCOL if PUSH_SUBPROTOCOL in offers else None)
                raise
            try:
                await websocket.accept(PUSH_SUBPROTOCOL)
            except BaseException:
                await asyncio.to_thread(intake.close)
                raise
            try:
                await _first(_take(websocket, intake), *(end(websocket, stream_id) for end in ends))
            except SessionError as error:
                _LOG.info("stream %s: a phone or capture node is closed: %s", stream_id, error.detail)
                raise
        except SessionError as error:
            await _close(websocket, error.close_code, error.detail)
        except ClientDisconnected:  # perhaps before it was accepted, which is for uvicorn to know
            raise
        except (WebSocketDisconnect, ConnectionError):
            return
        except Exception:
            _LOG.exception("stream %s: a capture node's session broke", stream_id)
            await _close(websocket, CloseCode.FAULT, "internal server error")

    return router


async def _first(*works: Coroutine[Any, Any, None]) -> None:
    """Run all until one ends, and raise what that one raised."""
    tasks = [asyncio.create_task(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()


async def _take(websocket: WebSocket, intake: AnyIntake) -> None:
    """Pictures and questions one after the other: a node that is too fast waits for its acknowledgements."""
    loop = asyncio.get_running_loop()
    thread = ThreadPoolExecutor(1, thread_name_prefix="pushed")  # a worker that hangs could take the shared pool's
    try:
        while True:
            received = await _receive(websocket)
            if received["type"] == "websocket.disconnect":
                return
            data = received.get("bytes")
            if not isinstance(data, bytes):
                answered = await loop.run_in_executor(thread, answer_question, received["text"], intake.wanted)
                await websocket.send_text(json.dumps(answered))
                continue
            message = parse_push(data)
            answer = {"type": "ack", "camera": message.camera, "sequence": message.sequence}
            try:
                await loop.run_in_executor(thread, intake.accept, message)
            except InputError as error:
                answer |= {"type": "refused", "reason": error.fault}
            await websocket.send_text(json.dumps(answer))
    finally:
        thread.shutdown(wait=False)
        await asyncio.to_thread(intake.close)


async def _receive(websocket: WebSocket) -> Message:
    try:
        async with asyncio.timeout(_MAX_SILENCE_SECONDS):
            return await websocket.receive()
    except TimeoutError:
        raise SessionError(
            CloseCode.BUSY, f"nothing came for {_MAX_SILENCE_SECONDS:g} s; connect again to send pictures"
        ) from None


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    reason = reason.encode()[:_MAX_REASON_BYTES].decode(errors="ignore")
    with contextlib.suppress(RuntimeError, WebSocketDisconnect, ClientDisconnected, ConnectionError):
        await websocket.close(code, reason)
