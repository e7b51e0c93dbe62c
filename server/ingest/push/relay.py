"""Passes pushed pictures from the serving process to the worker that trains, over a Unix socket.

Each picture gets an answer, which is empty or says in one sentence why the picture was refused. An empty message asks
which cameras are wanted, and is answered in JSON.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import TYPE_CHECKING, Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError
from streamlod.server.ingest.push.message import MAX_MESSAGE_BYTES, PushMessage, pack_push, parse_push

if TYPE_CHECKING:
    from streamlod.server.ingest.push.intake import Intake

_LOG = logging.getLogger(__name__)
_MAX_ANSWER_BYTES = 65536  # the most cameras that a rig may have, with long names
_WHICH_CAMERAS = b""
_MAX_PUSH_BYTES = MAX_MESSAGE_BYTES + 1024
_BACKLOG = 64
_AGAIN_SECONDS = 1.0  # after which connections are taken again, when one could not be


class RelayedIntake:
    """The serving process's end: an `Intake` that is in another process.

    Args:
        path: of the worker's socket.

    Raises:
        InputError: the worker does not listen.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._pipe: Connection = Client(str(path), family="AF_UNIX")
        except OSError as error:
            raise InputError(path, "no rig takes pictures there now; try again later") from error

    def accept(self, message: PushMessage) -> None:
        """Hand a picture to the worker and wait for its answer.

        Raises:
            InputError: the worker refused it.
            SessionError: the worker has gone; there may be another one soon.
        """
        if refusal := self._ask(pack_push(message)):
            raise InputError(f"camera {message.camera}", refusal.decode(errors="replace"))

    def wanted(self) -> dict[str, Any]:
        """See `Intake.wanted`; SessionError where the worker has gone."""
        found: dict[str, Any] = json.loads(self._ask(_WHICH_CAMERAS))
        return found

    def close(self) -> None:
        """The capture node has gone."""
        self._pipe.close()

    def _ask(self, message: bytes) -> bytes:
        try:
            self._pipe.send_bytes(message)
            return self._pipe.recv_bytes(_MAX_ANSWER_BYTES)
        except (OSError, EOFError) as error:
            raise SessionError(CloseCode.BUSY, "the stream takes no pictures at present; try again later") from error


@contextlib.contextmanager
def listening(path: Path, make_intake: Callable[[], Intake]) -> Iterator[None]:
    """Take pictures from the serving process at `path` while the context lasts.

    Raises:
        InputError: the socket cannot be made there.
    """
    stopping = threading.Event()

    def serve(pipe: Connection) -> None:
        intake = make_intake()
        try:
            while not stopping.is_set():
                message = pipe.recv_bytes(_MAX_PUSH_BYTES)
                pipe.send_bytes(_answer(intake, message))
        except (OSError, EOFError):
            pass
        finally:
            pipe.close()
            intake.close()

    with serving_socket(path, serve):
        try:
            yield
        finally:
            stopping.set()


@contextlib.contextmanager
def serving_socket(path: Path, serve: Callable[[Connection], None]) -> Iterator[None]:
    """Take connections at `path` while the context lasts; the socket is this user's alone.

    Args:
        serve: called with each connection on a thread of its own; closes it.

    Raises:
        InputError: the socket cannot be made there.
    """
    path.unlink(missing_ok=True)
    mask = os.umask(0o177)
    try:
        listener = Listener(str(path), family="AF_UNIX", backlog=_BACKLOG)
    except OSError as error:
        raise InputError(path, f"no socket can be made there ({error.strerror})") from error
    finally:
        os.umask(mask)
    stopping = threading.Event()

    def accept() -> None:
        while not stopping.is_set():
            try:
                pipe = listener.accept()
            except OSError as error:
                if not stopping.wait(_AGAIN_SECONDS):  # such as too many open files; later ones are taken again
                    _LOG.warning("a connection for pushed pictures cannot be taken (%s)", error)
                continue
            if stopping.is_set():  # the one that wakes this
                pipe.close()
            else:
                threading.Thread(target=serve, args=(pipe,), daemon=True, name="pushed").start()

    thread = threading.Thread(target=accept, daemon=True, name="push socket")
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        with contextlib.suppress(OSError):
            Client(str(path), family="AF_UNIX").close()  # wakes accept
        thread.join(1)
        listener.close()
        path.unlink(missing_ok=True)


def pass_on(asking: Connection, answering: Connection) -> None:
    """Pass pushed pictures one way and their answers the other, one at a time, until either end has gone."""
    with contextlib.suppress(OSError, EOFError), asking, answering:
        while True:
            answering.send_bytes(asking.recv_bytes(_MAX_PUSH_BYTES))
            asking.send_bytes(answering.recv_bytes(_MAX_ANSWER_BYTES))


def _answer(intake: Intake, message: bytes) -> bytes:
    try:
        if message == _WHICH_CAMERAS:
            return json.dumps(intake.wanted()).encode()
        intake.accept(parse_push(message))
    except InputError as error:
        return error.fault.encode()
    except SessionError as error:
        return error.detail.encode()
    return b""
