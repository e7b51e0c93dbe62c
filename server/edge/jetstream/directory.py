"""Which streams there are: one description a stream, the newest message of its subject, told again every second."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from dataclasses import dataclass, replace
from typing import Any

from nats.errors import Error
from nats.js.api import DiscardPolicy, StorageType, StreamConfig
from nats.js.errors import BadRequestError

from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.messages import Names
from streamlod.server.edge.jetstream.reading import Selection, follow
from streamlod.server.edge.origin import OriginStream
from streamlod.server.protocol.messages import PROTOCOL_VERSION
from streamlod.server.settings import Settings

_LOG = logging.getLogger(__name__)
TELL_SECONDS = 1.0
SILENT_SECONDS = 5.0  # after which a publisher is taken for lost
_RETRY_SECONDS = 0.25
_OTHER_CONFIG = 10058  # JetStream's error code for "stream name already in use with a different configuration"
MAX_REFUSED = 1000  # streams whose fault is kept in mind, so that the log has it once
_CHANGES = {"starting", "live", "degraded"}  # states in which packets are to be expected


async def create_stream(connection: NatsConnection, config: StreamConfig) -> bool:
    """Make a JetStream stream where it is missing; returns False where one is there that is set up differently.

    Raises:
        OSError, nats.errors.Error: JetStream does not answer, or refuses.
    """
    try:
        await connection.jetstream.add_stream(config)
    except BadRequestError as error:
        if error.err_code != _OTHER_CONFIG:
            raise
        return False
    return True


def directory_config(names: Names, settings: Settings) -> StreamConfig:
    """Settings of the JetStream stream that holds all descriptions; one goes when its packets are too old."""
    return StreamConfig(
        name=names.directory,
        subjects=[names.description("*")],
        max_msgs_per_subject=1,
        max_age=max(settings.retention.seconds, SILENT_SECONDS),
        duplicate_window=SILENT_SECONDS,
        storage=StorageType.FILE,
        discard=DiscardPolicy.OLD,
        num_replicas=settings.jetstream.replicas,
        allow_direct=True,
    )


@dataclass(frozen=True, slots=True)
class Told:
    """The last description that a publisher sent.

    Attributes:
        description: of the stream.
        told_at: monotonic time at which it arrived here.
        clock_ahead_ns: of the publisher's clock; 0 until it has said something while this server listened.
    """

    description: OriginStream
    told_at: float
    clock_ahead_ns: int


class Directory:
    """The descriptions of all streams, as this server knows them.

    Args:
        connection: to NATS.
        names: of streams and subjects.
        settings: of the server.
    """

    def __init__(self, connection: NatsConnection, names: Names, settings: Settings) -> None:
        self._connection, self._names, self._settings = connection, names, settings
        self._told: dict[str, Told] = {}
        self._refused: dict[str, str] = {}  # why a stream's description cannot be used, as the log has it
        self._begun_ns = time.time_ns()
        self.fault = "no answer yet"

    def find(self, stream: str) -> Told | None:
        """The description of a stream; degraded where its publisher is silent."""
        told = self._told.get(stream)
        if told is None or told.description.state not in _CHANGES:
            return told
        if time.monotonic() - told.told_at <= SILENT_SECONDS:
            return told
        detail = f"the server that publishes it has said nothing for {SILENT_SECONDS:g} s"
        return replace(told, description=told.description.model_copy(update={"state": "degraded", "detail": detail}))

    def streams(self) -> list[OriginStream]:
        """All streams, those that are no longer told of left out once their packets are gone."""
        oldest = time.monotonic() - self._settings.retention.seconds
        self._told = {name: told for name, told in self._told.items() if told.told_at > oldest}
        return [told.description for name in self._told if (told := self.find(name)) is not None]

    async def run(self) -> None:
        """Listen for descriptions, until cancelled."""

        def on_state(fault: str) -> None:
            self.fault = fault

        selection = Selection(self._names.directory, self._names.description("*"), newest=True)
        while True:
            try:
                if not await create_stream(self._connection, directory_config(self._names, self._settings)):
                    _LOG.warning(
                        "the JetStream stream %s differs from this server's settings (replicas, retention) and is left "
                        "as it is",
                        self._names.directory,
                    )
                break
            except (Error, OSError) as error:
                self.fault = str(error) or "no answer"
                await asyncio.sleep(_RETRY_SECONDS)
        async for message in follow(self._connection, selection, 1, on_state):
            stored_ns = int(message.metadata.timestamp.timestamp() * 1e9)
            self._take(message.subject.rpartition(".")[2], message.data, is_new=stored_ns > self._begun_ns)

    def _take(self, stream: str, body: bytes, *, is_new: bool) -> None:
        if not body:
            self._told.pop(stream, None)
            self._refused.pop(stream, None)
            return
        try:
            values = json.loads(body)
            description = _checked(values)
        except (ValueError, RecursionError) as error:
            self._refuse(stream, str(error)[:200])
            return
        self._refused.pop(stream, None)
        if description.id != stream:
            return
        sent_ns, earlier = values.get("server_time_ns"), self._told.get(stream)
        ahead_ns = 0 if earlier is None else earlier.clock_ahead_ns
        if is_new and type(sent_ns) is int:
            ahead_ns = sent_ns - time.time_ns()
        self._told[stream] = Told(description, time.monotonic(), ahead_ns)

    def _refuse(self, stream: str, fault: str) -> None:
        """Write to the log why a stream is left out, once for each reason; the oldest one makes room for a new one."""
        if self._refused.pop(stream, None) != fault:
            _LOG.warning("stream %.80s: its description in JetStream cannot be used (%s)", stream, fault)
        self._refused[stream] = fault
        if len(self._refused) > MAX_REFUSED:
            del self._refused[next(iter(self._refused))]


def _checked(values: Any) -> OriginStream:
    """A description.

    Raises:
        ValueError: it is none that this version can use.
    """
    version = values.get("protocol", PROTOCOL_VERSION) if isinstance(values, dict) else None
    if version != PROTOCOL_VERSION:
        raise ValueError(f"version {version!r:.20} of the protocol, not {PROTOCOL_VERSION}")
    found = OriginStream.model_validate(values)
    is_live = found.sound is not None and found.sound.live
    return found if is_live else found.model_copy(update={"sound": None})  # files do not go through NATS
