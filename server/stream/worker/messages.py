"""The messages of a worker, and what each of them changes in its stream."""

from __future__ import annotations

import json
import logging
from typing import Any

from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, StreamPacket, stream_packet
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import FrameStages, Stage, StageTimer
from streamlod.server.stream.worker.encoder_run import EncoderRun
from streamlod.server.worker.camera_pictures import unpack_pictures
from streamlod.server.worker.ingest_report import complaint, sound_fault
from streamlod.server.worker.messages import Tag

_LOG = logging.getLogger(__name__)


class WorkerMessages:
    """Changes a stream by the messages of its workers.

    Args:
        stream: that they are for.
        run: of the encoder that came before.

    Attributes:
        run: of the encoder whose packets come.
    """

    def __init__(self, stream: Stream, run: EncoderRun) -> None:
        self._stream, self.run = stream, run
        self._untold: dict[Position, list[Stage]] = {}  # of packets, until the worker tells its own stages

    async def take(self, tag: Tag, body: bytes) -> None:
        """Take a message that is about packets, or about what they are made from.

        Raises:
            StreamlodError: it cannot be used.
            ValueError: it is malformed.
        """
        match tag:
            case Tag.PACKET | Tag.PREVIEW:
                await self._take_packet(body, record=tag is Tag.PACKET)
            case Tag.REPORT:
                self._take_report(json.loads(body))
            case Tag.PROGRESS:
                self._stream.progress = json.loads(body)
                self._stream.tell(event("progress", **(self._stream.progress or {})))
            case Tag.SOUND:
                self._stream.hear(body)
            case Tag.MICROPHONE:
                self._stream.sound_track.camera = json.loads(body)["camera"]
            case Tag.INGEST:
                self._take_figures(json.loads(body))
            case Tag.PICTURES:
                self._stream.camera_pictures = self._stream.camera_pictures | unpack_pictures(body)
            case Tag.EPOCH:
                self.run = self.run.anew()
                if self._stream.played_file is not None:
                    await self._stream.bus.stop_keeping()

    async def _take_packet(self, data: bytes, *, record: bool) -> None:
        """Decode a packet, record it, send it and retain it, in this order: nobody gets what is unusable or lost."""
        stream = self._stream
        packet = stream_packet(stream.sequence, self.run.next_epoch, data)
        timer = StageTimer()
        decoded = await stream.hub.decode(packet)
        timer.end("decode")
        if record:
            stream.sound_track.record_until(packet.info.time_ns)
            await stream.bus.record(packet)
            timer.end("retain")
        self._begin_epoch(packet)
        stream.hub.send(decoded, stream.window_message())
        timer.end("send")
        stream.publish(packet)
        if stream.traces.listeners:
            self._untold.setdefault(packet.position, []).extend(timer.stages)
        if record:
            self._enter_live()

    def _begin_epoch(self, first: StreamPacket) -> None:
        """Announce a new epoch at the moment its first packet becomes the newest.

        If it were announced earlier, a viewer that joins in between would be told the old epoch and never the new one.
        """
        if self.run.is_over:
            self.run = self.run.begun()
            # before anybody sees its packets: no epoch is used twice
            self._stream.note(epoch=self.run.epoch, **self.run.note(first.position.version))
            self._stream.tell(event("epoch", epoch=self.run.epoch))

    def _take_report(self, report: dict[str, Any] | None) -> None:
        self._stream.report = report
        self._tell_stages(report.pop("stages", []) if report else [])
        self.run = self.run.reported(report)
        if report:
            self._stream.note(**self.run.note(report["version"]))

    def _tell_stages(self, told: list[tuple[str, int, int]]) -> None:
        """Report the stages of packets since the last report; `told` are the worker's for the newest of them."""
        stream = self._stream
        untold, self._untold = self._untold, {}
        for position, stages in untold.items():
            worker = [Stage(*each) for each in told] if position == stream.newest else []
            stream.traces.tell(FrameStages(stream.id, stream.incarnation, position, worker, stages, is_origin=True))

    def _take_figures(self, figures: dict[str, Any]) -> None:
        """Take what the worker tells of its cameras; a stream is degraded while they lack something."""
        stream = self._stream
        stream.ingest = figures
        if stream.state == "starting":
            if (fault := complaint(figures)) != stream.detail:
                _LOG.info("stream %s: starting: %s", stream.id, fault or "all cameras deliver")
            stream.enter("starting", fault)
        elif not self.run.is_over:  # until a restarted worker has sent a packet, the stream stays degraded
            self._enter_live()

    def _enter_live(self) -> None:
        """Live, or degraded while a camera is missing."""
        figures = self._stream.ingest
        fault = complaint(figures) if figures else ""
        self._stream.enter("degraded" if fault else "live", fault or (sound_fault(figures) if figures else ""))
