"""The latest events of streams and their viewers, for programs that want to know without asking."""

from __future__ import annotations

import secrets
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

MAX_EVENTS = 1000  # that are kept for readers who come back


@dataclass(frozen=True, slots=True)
class ServerEvent:
    """An event of the server.

    Attributes:
        id: the run of the server and a number that counts up in it, as in ``5f1c9a02-17``.
        type: ``stream.`` or ``viewer.`` and what happened.
        stream: id of the stream.
        time_ns: Unix time.
        data: further fields, by type.
    """

    id: str
    type: str
    stream: str
    time_ns: int
    data: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """EVENT of docs/protocol.md."""
        at = datetime.fromtimestamp(self.time_ns / 1e9, UTC).isoformat(timespec="milliseconds")
        return {"id": self.id, "type": self.type, "stream": self.stream, "at": at, "data": self.data}


class Feed:
    """The newest events; `listeners` are called with each one and must not raise."""

    def __init__(self) -> None:
        self._run = secrets.token_hex(4)
        self._count = 0
        self._events: deque[ServerEvent] = deque(maxlen=MAX_EVENTS)
        self.listeners: set[Callable[[ServerEvent], None]] = set()

    def tell(self, kind: str, stream: str, **data: Any) -> None:
        """Something has happened to a stream or its viewers."""
        self._count += 1
        happened = ServerEvent(f"{self._run}-{self._count}", kind, stream, time.time_ns(), data)
        self._events.append(happened)
        for listener in tuple(self.listeners):
            listener(happened)

    def after(self, last_id: str) -> list[ServerEvent]:
        """The events after the one of that id; all that are kept where it is not among them any more."""
        events = list(self._events)
        known = next((number for number, each in enumerate(events) if each.id == last_id), -1)
        return events[known + 1 :]
