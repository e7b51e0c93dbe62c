"""Ports for programs that are told one before they listen there."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager


def free_ports(count: int) -> list[int]:
    """Ports of loopback that nobody has now; another program may take them before they are used."""
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.socket()) for _ in range(count)]
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]


@contextmanager
def held_ports(count: int) -> Iterator[list[int]]:
    """Ports of loopback that nobody else gets while the context lasts; nobody listens there yet.

    Sockets that have them all the time, and never listen, keep them: Linux gives such a port to nobody who asks for a
    free one, but lets whoever asks for this one and sets SO_REUSEADDR, as servers do, listen there.
    """
    with ExitStack() as stack:
        holders = [stack.enter_context(socket.socket()) for _ in range(count)]
        for holder in holders:
            holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            holder.bind(("127.0.0.1", 0))
        ports = [holder.getsockname()[1] for holder in holders]
        if sys.platform != "linux":
            stack.close()
        yield ports
