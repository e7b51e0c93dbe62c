"""TCP connections between a worker's actor and its local process, opened with a secret that only the two know."""

from __future__ import annotations

import contextlib
import hmac
import logging
import os
import secrets
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

_LOG = logging.getLogger(__name__)
SECRET_BYTES = 32
MAX_UNPROVEN = 32  # connections at a time that have not shown the secret yet; further ones are closed
_PROOF_SECONDS = 5.0
_DIAL_SECONDS = 5.0
_AGAIN_SECONDS = 1.0  # after which connections are taken again, when one could not be
_KEEPALIVE_PROBES = 3  # of one second each; whoever waits for a machine that answers none has lost the connection


@dataclass(frozen=True, slots=True)
class LinkAddress:
    """Where somebody listens, and the secret that opens a connection there."""

    host: str
    port: int
    secret: bytes = field(repr=False)


@contextlib.contextmanager
def listening_at(host: str, serve: Callable[[Connection], None]) -> Iterator[LinkAddress]:
    """Take connections at a free port of `host` while the context lasts.

    Args:
        serve: called on a thread of its own with each connection whose other end knows the secret; closes it.

    Raises:
        OSError: nothing can listen there.
    """
    secret = secrets.token_bytes(SECRET_BYTES)
    places = threading.BoundedSemaphore(MAX_UNPROVEN)
    stopping = threading.Event()

    def prove(found: socket.socket) -> None:
        try:
            known = _shows(found, secret)
        finally:
            places.release()
        if known:
            serve(_connection(found))
        else:
            found.close()

    def accept(listener: socket.socket) -> None:
        while True:
            try:
                found, _ = listener.accept()
            except OSError as error:
                if stopping.wait(_AGAIN_SECONDS):
                    return
                _LOG.warning("a connection cannot be taken (%s)", error)  # such as too many open files
                continue
            if places.acquire(blocking=False):
                threading.Thread(target=prove, args=(found,), daemon=True, name="link").start()
            else:
                found.close()

    with socket.create_server((host, 0)) as listener:
        threading.Thread(target=accept, args=(listener,), daemon=True, name="links").start()
        try:
            yield LinkAddress(host, listener.getsockname()[1], secret)
        finally:
            stopping.set()
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes accept


def dial(address: LinkAddress) -> Connection:
    """Connect to a listener.

    Raises:
        OSError: nobody listens there.
    """
    with socket.create_connection((address.host, address.port), timeout=_DIAL_SECONDS) as found:
        found.sendall(address.secret)
        return _connection(found)  # which takes the socket over, so that only a broken one is closed here


def cut(connection: Connection) -> None:
    """End a connection on which another thread may be waiting; that one then closes it."""
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(connection.fileno())) as twin:
        twin.shutdown(socket.SHUT_RDWR)


def _shows(found: socket.socket, secret: bytes) -> bool:
    """Whether the other end sends the secret in time."""
    limit = time.monotonic() + _PROOF_SECONDS
    shown = b""
    try:
        while len(shown) < len(secret):
            found.settimeout(max(0.001, limit - time.monotonic()))
            if not (more := found.recv(len(secret) - len(shown))):
                return False
            shown += more
    except OSError:
        return False
    return hmac.compare_digest(shown, secret)


def _connection(found: socket.socket) -> Connection:
    """A connection for messages; blocks, and ends soon after the other machine has vanished."""
    found.settimeout(None)
    found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if sys.platform == "linux":
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
        found.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _KEEPALIVE_PROBES)
    return Connection(found.detach())
