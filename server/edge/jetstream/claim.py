"""This server's right to publish a stream, and to describe it to others.

A publisher replaces a stream's description only if nobody else has since (JetStream's expected last sequence), so of
two servers that train streams of one id, one publishes.
"""

from __future__ import annotations

import json
import secrets
import time
from dataclasses import dataclass, field
from typing import Any

from nats.js.api import RawStreamMsg
from nats.js.errors import APIError, NotFoundError

from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import SILENT_SECONDS
from streamlod.server.edge.jetstream.messages import Names
from streamlod.server.protocol.messages import PROTOCOL_VERSION

_PUBLISH_SECONDS = 1.0
_WRONG_LAST = 10071  # JetStream's error code for "wrong last sequence"
_NOBODY = ""


@dataclass(slots=True)
class Claim:
    """This server's right to publish a stream.

    Attributes:
        stream: its id.
        holder: names this server and this run of it; empty in a description that nobody tells any more.
    """

    connection: NatsConnection
    names: Names
    stream: str
    holder: str = field(default_factory=lambda: secrets.token_hex(8))
    _sequence: int = 0  # of the description that is there
    _other: tuple[int, float] = (0, 0.0)  # sequence of another server's description, and since when that is known

    async def tell(self, description: dict[str, Any], *, leaving: bool = False) -> bool:
        """Replace the description; returns False where another server publishes the stream.

        Raises:
            OSError, nats.errors.Error: JetStream does not answer.
        """
        about = {"protocol": PROTOCOL_VERSION, "server_time_ns": time.time_ns()}
        told = description | about | {"holder": _NOBODY if leaving else self.holder}
        for _ in range(2):
            try:
                await self._put(json.dumps(told).encode())
            except APIError as error:
                if error.err_code != _WRONG_LAST:
                    raise
                if not await self._may_replace(description["incarnation"]):
                    return False
            else:
                return True
        return False

    async def remove(self) -> None:
        """The stream was deleted."""
        await self._put(b"")

    async def _put(self, body: bytes) -> None:
        ack = await self.connection.jetstream.publish(
            self.names.description(self.stream),
            body,
            timeout=_PUBLISH_SECONDS,
            stream=self.names.directory,
            headers={"Nats-Expected-Last-Subject-Sequence": str(self._sequence)},
        )
        self._sequence = ack.seq

    async def _may_replace(self, incarnation: str) -> bool:
        """Whether what is there is our own, given up, or of a server that has been silent; takes note of it."""
        found = await self._newest()
        sequence = 0 if found is None or found.seq is None else found.seq
        if sequence != self._other[0]:
            self._other = sequence, time.monotonic()
        holder, held = _holder_of(found)
        silent = time.monotonic() - self._other[1] > SILENT_SECONDS
        if holder in {_NOBODY, self.holder} or held == incarnation or silent:
            self._sequence = sequence
            return True
        return False

    async def _newest(self) -> RawStreamMsg | None:
        try:
            subject = self.names.description(self.stream)
            return await self.connection.jetstream.get_last_msg(self.names.directory, subject)
        except NotFoundError:
            return None


def _holder_of(found: RawStreamMsg | None) -> tuple[object, object]:
    """Holder and incarnation of a description."""
    try:
        values = json.loads((found.data if found else None) or b"{}")
        return values.get("holder", _NOBODY), values.get("incarnation")
    except (ValueError, AttributeError, RecursionError):
        return _NOBODY, None
