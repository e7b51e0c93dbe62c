"""One stream of another server, as JetStream has it: followed from its newest keyframe, its past behind that."""

from __future__ import annotations

import asyncio
import logging
import time
from contextlib import aclosing

from streamlod.server.edge.ending import end
from streamlod.server.edge.jetstream.archive import Archive, id_of
from streamlod.server.edge.jetstream.bus import ArchiveBus
from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import Directory
from streamlod.server.edge.jetstream.messages import Assembler, Names
from streamlod.server.edge.jetstream.reading import Selection, follow, read
from streamlod.server.edge.origin import OriginStream
from streamlod.server.edge.origin_messages import OriginMessages
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Place, stream_packet
from streamlod.server.settings import Settings

_LOG = logging.getLogger(__name__)
_RETRY_SECONDS = 0.25
_LOST = "it does not answer"  # what viewers hear; the connection's log says more
_LOOK_SECONDS = 0.25  # between two looks at the stream's state
_SOUND_BEFORE = 500  # messages before the newest keyframe, among which its sound lies: it was stored while that trained


class ArchivedStream:
    """See `server.edge.supply.Supply`; for one pull.

    Args:
        connection: to NATS.
        names: of streams and subjects.
        directory: where its state is told.
        settings: of the server.
        stream: what was told last.
    """

    origin_name = "NATS JetStream"

    def __init__(
        self, connection: NatsConnection, names: Names, directory: Directory, settings: Settings, stream: OriginStream
    ) -> None:
        self._connection, self._directory, self._stream = connection, directory, stream
        self._packet_bytes = settings.limits.packet_bytes
        self._archive = Archive(connection, names, stream.id, stream.incarnation, self._packet_bytes)
        self.bus = ArchiveBus(settings.retention.memory_bytes, self._archive)
        self._lost = False

    async def pull(self, taker: OriginMessages) -> None:
        """See `Supply`."""
        self._greet(taker)
        while True:
            try:
                await self._archive.load()
                await self._begin_sound(taker)
                break
            except OSError as error:
                _LOG.debug("stream %s: %s", self._stream.id, error)
                taker.on_break(_LOST)
                await asyncio.sleep(_RETRY_SECONDS)
        tasks = [asyncio.create_task(work) for work in (self._archive.run(), self._follow(taker), self._tell(taker))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()
        finally:
            await end(*tasks)

    def _greet(self, taker: OriginMessages) -> None:
        told, now_ns = self._directory.find(self._stream.id), time.time_ns()
        state = self._stream if told is None else told.description
        ahead_ns = 0 if told is None else told.clock_ahead_ns
        taker.on_welcome(
            {
                "incarnation": state.incarnation,
                "server_time_ns": now_ns + ahead_ns,
                "state": state.state,
                "detail": state.detail,
            },
            now_ns,
        )

    async def _begin_sound(self, taker: OriginMessages) -> None:
        """Hand on the sound that was stored shortly before the newest keyframe.

        Raises:
            OSError: NATS does not answer.
        """
        key = self._archive.newest_key or 1
        selection = Selection(self._archive.stream, self._archive.sound)
        async with aclosing(read(self._connection, selection, max(1, key - _SOUND_BEFORE), key)) as messages:
            async for message in messages:
                taker.on_sound(message.data)

    async def _follow(self, taker: OriginMessages) -> None:
        """Hand on every packet from the newest keyframe on; after a gap, from the next keyframe on."""

        def on_state(fault: str) -> None:
            self._lost = bool(fault)
            if fault:
                _LOG.debug("stream %s: %s", self._stream.id, fault)
                taker.on_break(_LOST)

        assembler = Assembler(self._packet_bytes)
        held: Place | None = None
        complete = True  # nothing is missing behind `held`
        messages = follow(
            self._connection,
            Selection(self._archive.stream, self._archive.subject),
            self._archive.newest_key or 1,
            on_state,
        )
        async with aclosing(messages):
            async for message in messages:
                if message.subject == self._archive.sound:
                    taker.on_sound(message.data)
                    continue
                if (found := id_of(message)) is None or (data := assembler.push(found, message.data)) is None:
                    continue
                packet = stream_packet(0, found.position.epoch, data)
                if held is not None and packet.place <= held:  # stored twice
                    continue
                if not packet.is_key and (held is None or not packet.follows(held[0])):
                    complete = held is None
                    continue
                if not complete:
                    taker.on_event(event("skipped"))
                taker.on_event(event("epoch", epoch=found.position.epoch))
                await taker.on_packet(data)
                held, complete = packet.place, True

    async def _tell(self, taker: OriginMessages) -> None:
        """Hand on the stream's state, until it is deleted."""
        progress = self._stream.progress
        while (told := self._directory.find(self._stream.id)) is not None:
            state = told.description
            if not self._lost:
                taker.on_event(event("state", state=state.state, detail=state.detail))
            if state.progress != progress:
                progress = state.progress
                taker.on_event(event("progress", **(progress or {})))
            await asyncio.sleep(_LOOK_SECONDS)
