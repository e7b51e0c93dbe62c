"""The work of a stream's workers, as their supervisor tells of it: their messages, their endings, where they go on."""

from __future__ import annotations

import asyncio
import json
import logging
from dataclasses import replace

from streamlod.server.stream.stream import Stream
from streamlod.server.stream.worker.encoder_run import EncoderRun
from streamlod.server.stream.worker.messages import WorkerMessages
from streamlod.server.stream.worker.pausing import Pausing
from streamlod.server.stream.worker.placing import Placing
from streamlod.server.stream.worker.restoring import show_recorded
from streamlod.server.worker.messages import Resume, Tag
from streamlod.server.worker.supervisor import Ending

_LOG = logging.getLogger(__name__)


class Work:
    """The `supervisor.Owner` of one stream: changes the stream by what is told of its workers.

    Args:
        stream: that they work for.
        on_demand_seconds: for which a file is played on after its last viewer has gone.

    Attributes:
        messages: what packets and reports change.
        placing: the search for room in a cluster.
        pausing: the wait for viewers of a file.
    """

    def __init__(self, stream: Stream, on_demand_seconds: float) -> None:
        self._stream, recording = stream, stream.bus.recording
        self.messages = WorkerMessages(stream, EncoderRun(recording.last_epoch if recording else 0))
        self.placing = Placing(stream)
        self.pausing = Pausing(stream, on_demand_seconds)
        self._on_demand = False
        self._restoring = asyncio.Lock()  # held while the recording's last state is loaded

    def define(self, trained_from: str, *, on_demand: bool) -> None:
        """Begin with the first frame of another source, named as in `EncoderRun`, perhaps again for each viewer."""
        self._on_demand = on_demand
        self.messages.run = replace(self.messages.run.anew(), trained_from=trained_from)

    def begin(self) -> None:
        """A worker is started."""
        self.placing.begin()
        self.pausing.begin()

    async def restore(self) -> None:
        """Show the recording's last state, so that its past can be seen before a worker sends anything.

        If that is recent, and trained from what the stream is made from now, training will continue from it.
        """
        async with self._restoring:
            newest, recording = await show_recorded(self._stream), self._stream.bus.recording
            if newest is not None and recording is not None:
                self.messages.run = self.messages.run.resumed(recording.stored, newest)

    async def resume_point(self) -> Resume:
        """See `supervisor.Owner`."""
        async with self._restoring:
            self.messages.run, self._stream.ingest = self.messages.run.ended(), None
        if self.messages.run.frames == 0:
            return Resume()
        return Resume(tuple(await self._stream.hub.snapshot()), self.messages.run.frames)

    async def on_message(self, tag: Tag, body: bytes) -> None:
        """See `supervisor.Owner`."""
        if tag is Tag.PLACED:
            self.placing.end(json.loads(body)["node"])
            _LOG.info("stream %s: its worker runs on node %s", self._stream.id, self._stream.worker_node)
            return
        if tag in {Tag.PACKET, Tag.PREVIEW}:
            await self.pausing.until_wanted()
        await self.messages.take(tag, body)

    @property
    def waits_for_room(self) -> bool:
        """See `supervisor.Owner`. Who starts it by hand is told at once; what starts with the server waits."""
        return not self.placing.is_asked

    def on_restart(self, ending: Ending, delay_seconds: float) -> None:
        """See `supervisor.Owner`."""
        stream = self._stream
        _LOG.warning("stream %s: %s; restart in %g s", stream.id, ending.text, delay_seconds)
        self.placing.end()
        stream.enter("degraded" if stream.newest else "starting", f"{ending.text}; it is being restarted")

    def on_finish(self, ending: Ending) -> None:
        """See `supervisor.Owner`."""
        stream = self._stream
        _LOG.info("stream %s: %s", stream.id, ending.refused.sentence(bool) if ending.refused else ending.text)
        if stream.bus.recording is not None:
            asyncio.get_running_loop().create_task(stream.bus.recording.close())
        self.messages.run = self.messages.run.anew()  # whoever starts it again, by hand or as a viewer, has it all
        is_over = ending.done and not self._on_demand
        stream.note(trained_from="", **({"running": False} if is_over else {}))
        self.placing.end(refused=ending.refused)
        stream.enter("ended" if ending.done else "failed", ending.text)
