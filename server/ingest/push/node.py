"""`streamlod push`: a capture node, which sends its cameras' pictures to a server over a websocket each."""

from __future__ import annotations

import json
import logging
import ssl
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from streamlod.core.close_codes import REFUSALS
from streamlod.core.errors import InputError, StreamlodError
from streamlod.core.web_address import address_parts
from streamlod.server.ingest.push.capture import CaptureCamera, Taken
from streamlod.server.ingest.push.message import MAX_MESSAGE_BYTES, PUSH_SUBPROTOCOL, PushMessage, pack_push

_LOG = logging.getLogger(__name__)
_MAX_UNACKNOWLEDGED = 4  # unacknowledged pictures; a further one is dropped, because queueing it would add delay
_START_SECONDS = 0.5  # until all cameras are open
_MIN_DELAY, _MAX_DELAY = 0.25, 5.0  # seconds between attempts to connect
_ANSWER_SECONDS = 10.0


@dataclass(slots=True)
class Pushed:
    """Counts of one camera's pictures: accepted by the server, refused by it, dropped because it was too slow."""

    acknowledged: int = 0
    refused: int = 0
    dropped: int = 0


def push(
    url: str, cameras: Sequence[CaptureCamera], token: str | None = None, ca: Path | None = None
) -> dict[str, Pushed]:
    """Send all cameras' pictures until their sources end or the process is interrupted; returns the counts by camera.

    A broken connection is opened again; pictures taken meanwhile are dropped.

    Args:
        ca: certificates (PEM) to trust instead of the system's, for ``wss`` addresses.

    Raises:
        StreamlodError: `url` is no address, a source or `ca` cannot be read, or the server refuses the node for good.
    """
    address_parts("the stream", url)
    trust = None if ca is None else _trusting(ca)
    start_ns = time.time_ns() + round(_START_SECONDS * 1e9)
    nodes = [_Node(url, camera, token, trust) for camera in cameras]
    threads = [threading.Thread(target=node.run, args=(start_ns,), daemon=True) for node in nodes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    failures = [node.failure for node in nodes if node.failure is not None]
    if failures:
        raise failures[0]
    return {node.camera.name: node.pushed for node in nodes}


@dataclass(slots=True)
class _Node:
    """One camera and its connection."""

    url: str
    camera: CaptureCamera
    token: str | None
    trust: ssl.SSLContext | None
    pushed: Pushed = field(default_factory=Pushed)
    failure: StreamlodError | None = None
    _connection: _Connection | None = None
    _told: str = ""
    _retry_at: float = 0.0
    _delay: float = _MIN_DELAY

    def run(self, start_ns: int) -> None:
        """Push until the source ends."""
        try:
            for sequence, taken in enumerate(self.camera.pictures(start_ns)):
                self._send(sequence, taken)
            if self._connection is not None:
                self._connection.finish(self.pushed)
        except StreamlodError as error:
            self.failure = error
        except (WebSocketException, OSError) as error:
            _LOG.warning("camera %s: the connection broke at the end (%s)", self.camera.name, error)
            self.pushed.dropped += 0 if self._connection is None else self._connection.waiting
        finally:
            if self._connection is not None:
                self._connection.close()

    def _send(self, sequence: int, taken: Taken) -> None:
        try:
            if self._connection is None:
                if time.monotonic() < self._retry_at:
                    self.pushed.dropped += 1
                    return
                self._connection = _Connection(self.url, self.token, self.trust)
            message = PushMessage(self.camera.name, sequence, taken.capture_ns, taken.codec, taken.body)
            if self._connection.send(message, self.pushed):
                if self._told:
                    _LOG.info("camera %s: connected", self.camera.name)
                self._delay, self._told = _MIN_DELAY, ""
        except (WebSocketException, OSError) as error:
            self._break(error)

    def _break(self, error: Exception) -> None:
        if isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code in REFUSALS:
            raise InputError(self.url, f"refuses camera {self.camera.name}: {error.rcvd.reason}") from error
        reason = _reason(error)
        if reason != self._told:
            self._told = reason
            _LOG.warning("camera %s: no connection (%s); trying again", self.camera.name, reason)
        self.pushed.dropped += 1 if self._connection is None else self._connection.waiting
        if self._connection is not None:
            self._connection.close()
        self._connection, self._retry_at = None, time.monotonic() + self._delay
        self._delay = min(2 * self._delay, _MAX_DELAY)


class _Connection:
    """A connection, with its unacknowledged pictures."""

    def __init__(self, url: str, token: str | None, trust: ssl.SSLContext | None) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else None
        self._open = ExitStack()
        self._connection: ClientConnection = self._open.enter_context(
            connect(
                url,
                subprotocols=[Subprotocol(PUSH_SUBPROTOCOL)],
                additional_headers=headers,
                ssl=trust,
                compression=None,
                open_timeout=5,
                close_timeout=1,
            )
        )
        self.waiting, self._answered = 0, False
        self._told = ""

    def send(self, message: PushMessage, pushed: Pushed) -> bool:
        """Send a picture unless too many are on their way; whether the server has answered to any so far."""
        data = pack_push(message)
        if len(data) > MAX_MESSAGE_BYTES:
            raise InputError(f"camera {message.camera}", f"has pictures of more than {MAX_MESSAGE_BYTES >> 20} MiB")
        self.waiting += 1
        self._take_answers(pushed, 0)
        if self.waiting > _MAX_UNACKNOWLEDGED:
            self.waiting -= 1
            pushed.dropped += 1
        else:
            self._connection.send(data)
        return self._answered

    def finish(self, pushed: Pushed) -> None:
        """Wait for the last answers."""
        while self.waiting:
            self._take_answers(pushed, _ANSWER_SECONDS)

    def close(self) -> None:
        """Close the connection."""
        self._open.close()

    def _take_answers(self, pushed: Pushed, seconds: float) -> None:
        """Take the answers that are there, waiting so long for the first one."""
        while self.waiting:
            try:
                answer = json.loads(self._connection.recv(seconds))
            except TimeoutError:
                if seconds:
                    raise
                return
            self.waiting -= 1
            self._answered, seconds = True, 0
            if answer.get("type") == "ack":
                pushed.acknowledged += 1
                continue
            pushed.refused += 1
            if (reason := str(answer.get("reason"))) != self._told:
                self._told = reason
                _LOG.warning("camera %s: a picture is refused: %s", answer.get("camera"), reason)


def _trusting(ca: Path) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca)
    except OSError as error:  # ssl.SSLError, too
        raise InputError(ca, f"holds no certificates that can be read ({error.strerror or error})") from error


def _reason(error: Exception) -> str:
    if isinstance(error, ConnectionClosed) and error.rcvd is not None:
        return error.rcvd.reason or f"close code {error.rcvd.code}"
    return str(error)
