"""A thread that reads a source, and opens it again whenever it breaks, until it is stopped."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

import av

from streamlod.core.errors import InputError
from streamlod.server.ingest.cameras.address import Address

_LOG = logging.getLogger(__name__)
_MIN_DELAY, _MAX_DELAY = 0.25, 5.0  # seconds between attempts
_SETTLED_SECONDS = 5.0  # a connection that lasted so long resets the delay
ENDED = "it ended"
_LISTENS = "listening; its camera has not connected yet"


class SourceThread(ABC):
    """Reads a source on a thread.

    Args:
        name: of the thread, and in the log.
        address: of the source.

    Attributes:
        connections: how often it was opened.
    """

    def __init__(self, name: str, address: Address) -> None:
        self.connections = 0
        self._name, self._address = name, address
        self._stopping = threading.Event()
        self._abort: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @abstractmethod
    def _read(self) -> None:
        """One connection, from its beginning to its end; counts it in `connections`."""

    @abstractmethod
    def _gone(self, reason: str, *, ended: bool) -> None:
        """The source gives nothing for now, or no more because its file has `ended`."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Ask the thread to end, which it does at the next packet or timeout."""
        self._stopping.set()
        self._abort()

    def join(self, seconds: float) -> None:
        """Wait at most so long for the thread's end; a listening port ends only by timeout."""
        self._thread.join(seconds)

    def _interruptible(self, abort: Callable[[], None]) -> None:
        self._abort = abort

    def _run(self) -> None:
        delay = _MIN_DELAY
        if self._address.listens:
            self._gone(_LISTENS, ended=False)
        while not self._stopping.is_set():
            begin, before, reason = time.monotonic(), self.connections, ENDED
            try:
                self._read()
            except InputError as error:
                reason = error.fault
            except (av.FFmpegError, OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or str(error)
            except Exception as error:  # keep the thread: the source may come back
                _LOG.exception("%s", self._name)
                reason = f"{type(error).__name__}: {error}"
            if self._stopping.is_set():
                return
            lasted = time.monotonic() - begin
            if self._address.listens and self.connections == before and lasted > _MIN_DELAY:
                reason = _LISTENS
            ended = not self._address.is_live  # read again, a file would be no better, or begin anew
            self._gone(reason, ended=ended)
            if ended:
                return
            if self._address.listens and lasted > _MIN_DELAY:
                continue  # the next camera may be connecting already
            delay = _MIN_DELAY if lasted > _SETTLED_SECONDS else delay
            self._stopping.wait(delay)
            delay = min(2 * delay, _MAX_DELAY)
