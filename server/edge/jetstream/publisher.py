"""The publisher of what this server trains: packets in order, each until JetStream has acknowledged it."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

from nats.errors import Error
from nats.js.api import DiscardPolicy, RetentionPolicy, StorageType, StreamConfig
from nats.js.errors import BadRequestError, NotFoundError

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream.claim import Claim
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import SILENT_SECONDS, TELL_SECONDS, create_stream, directory_config
from streamlod.server.edge.jetstream.messages import MSG_ID, Names, pieces_of
from streamlod.server.protocol.packets import StreamPacket
from streamlod.server.settings import Settings
from streamlod.server.stream.description import describe
from streamlod.server.stream.stream import Stream

_LOG = logging.getLogger(__name__)
_ACK_SECONDS = 1.0  # after which a message is sent again; JetStream knows it by its id
_RETRY_SECONDS = 0.1
_LOOK_SECONDS = 0.1  # between two looks whether the state has changed
_DUPLICATE_SECONDS = 120.0  # in which JetStream knows a message again
_SAY_SECONDS = 10.0  # between two lines of the log about one trouble


@dataclass(frozen=True, slots=True)
class _Waiting:
    packet: StreamPacket
    stored: asyncio.Future[None]


class Publisher:
    """The outbox of one stream.

    Packets wait in memory while JetStream does not take them, `retention.memory_bytes` at most. If that is not enough,
    all that wait are left out and it goes on with the next keyframe.

    Args:
        connection: to NATS.
        names: of streams and subjects.
        settings: of the server.
        stream: whose packets these are.

    Attributes:
        lost_packets: that were left out.
    """

    def __init__(self, connection: NatsConnection, names: Names, settings: Settings, stream: Stream) -> None:
        self.stream = stream
        self._connection, self._names, self._settings = connection, names, settings
        self._claim = Claim(connection, names, stream.id)
        self._is_ours = asyncio.Event()
        self._refused_at: float | None = None
        self._stands_by = False  # another server publishes the stream; nothing waits here
        self._telling = asyncio.Lock()
        self._has_left = False
        self._queue: deque[_Waiting] = deque()
        self._queued = asyncio.Event()
        self._gap = False  # what comes does not follow what was stored, until a keyframe does
        self._may_be_missing = True  # what it needs in JetStream
        self._said_at = -_SAY_SECONDS
        self.waiting_bytes = self.lost_packets = 0

    def append(self, packet: StreamPacket) -> asyncio.Future[None] | None:
        """See `server.stream.bus.Outbox`."""
        if self._stands_by:
            return None
        if self.waiting_bytes + len(packet.data) > self._settings.retention.memory_bytes and self._queue:
            self._leave_out("more packets wait than memory_bytes allows")
        if self._gap and not packet.is_key:
            self.lost_packets += 1
            return None
        self._gap = False
        waiting = _Waiting(packet, asyncio.get_running_loop().create_future())
        self._queue.append(waiting)
        self.waiting_bytes += len(packet.data)
        self._queued.set()
        return waiting.stored

    async def run(self) -> None:
        """Publish until cancelled, or the stream was deleted."""
        sending = [asyncio.create_task(work) for work in (self._send(), self._send_sound())]
        try:
            while not self.stream.deleted:
                async with self._telling:
                    if not self._has_left:
                        await self._tell()
                state, limit = (self.stream.state, self.stream.detail), time.monotonic() + TELL_SECONDS
                for task in sending:
                    if task.done():
                        task.result()
                while time.monotonic() < limit and (self.stream.state, self.stream.detail) == state:
                    await asyncio.sleep(_LOOK_SECONDS)
            await self._remove()
        finally:
            await end(*sending)

    async def finish(self) -> None:
        """Wait for what is queued; then say that this server publishes the stream no more."""
        while self._queue and self._is_ours.is_set():
            await asyncio.sleep(0.02)
        async with self._telling:
            self._has_left = True
            if self._is_ours.is_set():
                await self._claim.tell(describe(self.stream), leaving=True)

    def stream_config(self) -> StreamConfig:
        """Settings of the JetStream stream that holds the packets, with the limits of a recording."""
        retention = self._settings.retention
        return StreamConfig(
            name=self._names.packets(self.stream.id),
            subjects=[self._names.subject(self.stream.id, "*", "*")],
            retention=RetentionPolicy.LIMITS,
            discard=DiscardPolicy.OLD,
            max_age=retention.seconds,
            max_bytes=retention.bytes,
            duplicate_window=min(_DUPLICATE_SECONDS, retention.seconds),
            storage=StorageType.FILE,
            num_replicas=self._settings.jetstream.replicas,
            allow_direct=True,
        )

    async def _tell(self) -> None:
        """Describe the stream; only the server that may do so sets up the JetStream stream of its packets."""
        try:
            if self._may_be_missing:
                await create_stream(self._connection, directory_config(self._names, self._settings))
            ours = await self._claim.tell(describe(self.stream))
            if ours and self._may_be_missing:
                if not await create_stream(self._connection, self.stream_config()):
                    await self._connection.jetstream.update_stream(self.stream_config())
                self._may_be_missing = False
        except (Error, OSError) as error:
            self._may_be_missing = True
            self._say(f"its description cannot be published ({error or 'no answer'})")
            return
        if ours:
            self._is_ours.set()
            self._refused_at, self._stands_by = None, False
            return
        self._is_ours.clear()
        self._may_be_missing = True  # or set up differently, by the server that publishes now
        self._refused_at = self._refused_at or time.monotonic()
        self._say("another server publishes a stream of this id")
        if time.monotonic() - self._refused_at > 2 * SILENT_SECONDS and not self._stands_by:
            self._stands_by = True
            self._discard()  # not lost: the other server's packets are the stream

    async def _send(self) -> None:
        while True:
            await self._is_ours.wait()
            while not self._queue:
                self._queued.clear()
                await self._queued.wait()
            waiting = self._queue[0]
            for found, data in pieces_of(self.stream.incarnation, waiting.packet, self._connection.piece_bytes):
                await self._store(found.kind, str(found), data)
            if self._queue and self._queue[0] is waiting:  # it was not left out meanwhile
                self._queue.popleft()
                self.waiting_bytes -= len(waiting.packet.data)
            if not waiting.stored.done():
                waiting.stored.set_result(None)

    async def _send_sound(self) -> None:
        """Publish live sound as it comes. While JetStream takes none it waits where it is held for viewers anyway."""
        track, heard, sent_ns = self.stream.sound_track, asyncio.Event(), 0
        track.listeners.add(heard.set)
        heard.set()  # some may have come before JetStream was reached
        try:
            while True:
                await heard.wait()
                heard.clear()
                while (facts := track.facts) and (pieces := await track.read(max(sent_ns, facts["begin_ns"]))):
                    for each in pieces:
                        name = f"{self.stream.incarnation}/s/{each.piece.begin_ns}"
                        await self._store("s", name, each.message.data)
                        sent_ns = each.piece.end_ns - 1
        finally:
            track.listeners.discard(heard.set)

    async def _store(self, kind: str, message_id: str, data: bytes) -> None:
        """Publish one message, as often as it takes; JetStream stores it once."""
        subject = self._names.subject(self.stream.id, self.stream.incarnation, kind)
        name = self._names.packets(self.stream.id)
        while True:
            await self._is_ours.wait()
            try:
                await self._connection.jetstream.publish(
                    subject, data, timeout=_ACK_SECONDS, stream=name, headers={MSG_ID: message_id}
                )
                return
            except (Error, OSError) as error:
                self._may_be_missing = True
                self._say(f"a packet cannot be published ({error or 'no answer'})")
            await asyncio.sleep(_RETRY_SECONDS)

    async def _remove(self) -> None:
        """The stream was deleted: remove its packets and its description."""
        while self._is_ours.is_set():
            try:
                with suppress(NotFoundError):
                    await self._connection.jetstream.delete_stream(self._names.packets(self.stream.id))
                with suppress(BadRequestError):  # it has been removed already, or another server has taken it over
                    await self._claim.remove()
                return
            except (Error, OSError) as error:
                self._say(f"it cannot be removed from JetStream ({error or 'no answer'})")
            await asyncio.sleep(_RETRY_SECONDS)

    def _leave_out(self, reason: str) -> None:
        """Give up what waits; readers go on with the next keyframe."""
        self._say(f"{len(self._queue)} packets are not published: {reason}")
        self.lost_packets += len(self._queue)
        self._discard()

    def _discard(self) -> None:
        for waiting in self._queue:
            waiting.stored.cancel()
        self._queue.clear()
        self.waiting_bytes, self._gap = 0, True

    def _say(self, text: str) -> None:
        if time.monotonic() - self._said_at > _SAY_SECONDS:
            self._said_at = time.monotonic()
            _LOG.warning("stream %s: %s", self.stream.id, text)
