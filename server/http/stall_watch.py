"""Cuts connections whose peer reads nothing of what is written to it, or too slowly.

A transport that is being closed waits for its write buffer to drain, for ever if the peer never reads; so does an
endpoint that writes. Both occupy one of the connections that the server may have.
"""

from __future__ import annotations

import asyncio
import sys
from collections import Counter


class StallWatch:
    """Checks a transport's write buffer at intervals, until `end`.

    Args:
        transport: what is watched.
        seconds: between two checks.
        turned_away: counts the connections that were cut.
        least_bytes: the connection is cut when bytes were waiting and fewer than these were sent between two checks.
    """

    def __init__(
        self, transport: asyncio.Transport, seconds: float, turned_away: Counter[str], least_bytes: float = 1
    ) -> None:
        self._transport, self._seconds, self._turned_away = transport, seconds, turned_away
        self._least_bytes = least_bytes
        self._loop = asyncio.get_running_loop()
        self._left = 0  # bytes waiting at the last check, or 0 if the buffer has drained since
        self._timer = self._loop.call_later(seconds, self._look)

    def emptied(self) -> None:
        """The write buffer has drained."""
        self._left = 0

    def end(self) -> None:
        """Stop checking."""
        self._timer.cancel()

    def _look(self) -> None:
        left = self._transport.get_write_buffer_size()
        if left:
            left += _kernel_bytes(self._transport)
        if self._left > 0 < left and self._left - left < self._least_bytes:
            self._turned_away["stalled"] += 1
            self._transport.abort()
            return
        self._left = left
        self._timer = self._loop.call_later(self._seconds, self._look)


def _kernel_bytes(transport: asyncio.Transport) -> int:
    """Bytes that the kernel has taken and the peer has not; 0 where the system does not tell.

    The kernel's buffer holds megabytes and takes new bytes in large steps, so without these a slow peer's progress
    would look like none for minutes.
    """
    raw = transport.get_extra_info("socket")
    if raw is None or sys.platform != "linux":
        return 0
    import fcntl
    import termios

    try:
        return int.from_bytes(fcntl.ioctl(raw.fileno(), termios.TIOCOUTQ, bytes(4)), sys.byteorder)
    except OSError:
        return 0
