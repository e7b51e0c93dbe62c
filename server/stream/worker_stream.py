"""A stream whose packets a worker process makes: its worker, its recording, its epochs."""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import secrets
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from streamlod.codec.sound.beside import find_sound
from streamlod.core.errors import StorageError, StreamlodError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.protocol.messages import event
from streamlod.server.protocol.packets import Position, StreamPacket, stream_packet
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import FrameStages, Stage, StageTimer, Traces
from streamlod.server.worker.camera_pictures import unpack_pictures
from streamlod.server.worker.cluster.driver import run_on_ray
from streamlod.server.worker.cluster.room import Shortage
from streamlod.server.worker.ingest_report import complaint, sound_fault
from streamlod.server.worker.process import Resume, Tag
from streamlod.server.worker.supervisor import Ending, Supervisor

_LOG = logging.getLogger(__name__)
_WAITS = "it starts with its first viewer"
_PLACING_SECONDS = 20.0  # that a start waits for room in a cluster, most of them for a local process to load Ray
MAX_AWAY_SECONDS = 60.0  # a server that was gone for longer trains its streams anew: what they film has changed


class WorkerStream(Stream):
    """A running or idle stream; owner of its supervisor.

    Args:
        spec: what it is made from.
        settings: of the server.
        recording: its place on disk, or None.
        push_socket: where its worker takes pictures that capture nodes push, or None.
        feed, traces: where its states and the stages of its frames are told.
    """

    def __init__(
        self,
        spec: StreamSpec,
        settings: Settings,
        recording: Recording | None = None,
        push_socket: Path | None = None,
        feed: Feed | None = None,
        traces: Traces | None = None,
    ) -> None:
        incarnation = recording.stored.incarnation if recording else secrets.token_hex(8)
        bus = Bus(settings.retention.memory_bytes, recording, keeps=spec.recorded)
        super().__init__(spec.id, incarnation, settings, bus, feed, traces)
        self._settings = settings
        self._frames_done = 0
        self._untold: dict[Position, list[Stage]] = {}  # of packets, until the worker tells its own stages
        self.define(spec, push_socket)
        created_ns = recording.stored.created_ns if recording else time.time_ns()
        self.created_at = datetime.fromtimestamp(created_ns / 1e9, UTC)
        self._epoch = recording.last_epoch if recording else 0
        self._new_epoch = True
        self._placed = asyncio.Event()  # or given up
        self._askers = 0  # calls that wait to be told whether there is room for it
        self._restoring = asyncio.Lock()  # held while the recording's last state is loaded
        self._refused: Shortage | None = None
        self._supervisor = self._make_supervisor()
        self._task: asyncio.Task[None] | None = None
        self._watched = asyncio.Event()
        self._stopping = False
        self._unwatched_since = 0.0  # monotonic time
        self._armed = False  # whether the next viewer starts it
        self._pause: asyncio.TimerHandle | None = None
        self._pausing: asyncio.Task[None] | None = None

    def define(self, spec: StreamSpec, push_socket: Path | None) -> None:
        """Make it from something else, from its first frame on; only while it does not run."""
        self.spec, self.push_socket, self._frames_done = spec, push_socket, 0
        self.source, self.played_file = spec.source, spec.play
        self.loop = spec.play is not None and spec.loop
        sound = None if spec.play is None else find_sound(spec.play)
        self.file_sound = None
        if sound is not None:
            self.file_sound = {"begin_ns": sound.begin_ns, "channels": sound.channels, "live": False}

    @property
    def etag(self) -> str:
        """Changes with what the stream is made from; a strong validator, without quotes."""
        state = json.dumps([self.incarnation, self.spec.to_json()], sort_keys=True)
        return hashlib.sha256(state.encode()).hexdigest()[:32]

    @property
    def is_ready(self) -> bool:
        """Whether viewers can come; a stream that waits for its first viewer is ready, too."""
        return super().is_ready or self._armed

    @property
    def restarts(self) -> int:
        """Worker restarts since the start."""
        return self._supervisor.restarts

    @property
    def worker_pid(self) -> int | None:
        """Process id of the worker."""
        return self._supervisor.pid

    @property
    def is_running(self) -> bool:
        """Whether there is a worker, or one is about to be started."""
        return self._task is not None and not self._task.done()

    def start(self) -> None:
        """Start the worker, unless it runs or the stream was deleted; an ended source begins again.

        One that is to run on demand waits for its first viewer.
        """
        if self.is_running or self.deleted:
            return
        self._note(running=True)
        self._refused = None
        self._armed = self.spec.on_demand
        if self._armed and not self.viewers:
            self._enter("idle", _WAITS)
        else:
            self._launch()

    async def until_placed(self, may_see: Callable[[str], bool]) -> str:
        """Wait, some seconds at most, until its worker has room in the cluster; at once where it needs none.

        Returns why there is no room, for somebody who may see such streams, and then it has failed; otherwise nothing.
        """
        if self.is_running and self._in_cluster:
            self._askers += 1
            try:
                async with asyncio.timeout(_PLACING_SECONDS):
                    await self._placed.wait()
            except TimeoutError:
                pass
            finally:
                self._askers -= 1
        return f"stream {self.id}: {self._refused.sentence(may_see)}" if self._refused else ""

    @property
    def _in_cluster(self) -> bool:
        """Whether its worker runs in a cluster; one that plays a file does not: it needs the file and little else."""
        return self._settings.jobs == "ray" and self.spec.job is not None

    def join(self) -> None:
        """A viewer has come; it may be what a stream on demand waits for."""
        super().join()
        self._watched.set()
        if self._pause is not None:
            self._pause.cancel()
        if self._armed and not self.is_running and self._pausing is None:
            self._launch()

    def leave(self) -> None:
        """A viewer has gone; after the last one, a stream on demand stops for now."""
        super().leave()
        self._unwatched_since = time.monotonic()
        if self._armed and not self.viewers:
            seconds = self._settings.on_demand_seconds
            self._pause = asyncio.get_running_loop().call_later(seconds, self._begin_pause)

    def _begin_pause(self) -> None:
        if self._armed and not self.viewers and self._pausing is None and not self.deleted:
            self._pausing = asyncio.create_task(self._wait_for_viewers())

    async def _wait_for_viewers(self) -> None:
        await self._end_worker()
        self._pausing = None
        if self._armed and self.viewers:  # somebody came meanwhile
            self._launch()
        elif self._armed:
            self._enter("idle", _WAITS)

    def _launch(self) -> None:
        if self.state in {"ended", "failed"}:
            self._frames_done, self._new_epoch = 0, True
        self._placed.clear()
        self._unwatched_since = time.monotonic()
        self._refused = self.progress = None
        self._supervisor = self._make_supervisor()
        self._enter("starting")
        self._task = asyncio.create_task(self._supervisor.run())

    async def restore(self) -> None:
        """Show the recording's last state, so that its past can be seen before the worker sends anything.

        If that is recent, and trained from what the stream is made from now, training will continue from it.
        """
        async with self._restoring:
            await self._restore()

    async def _restore(self) -> None:
        recording = self.bus.recording
        if recording is None or not recording.segments or self.hub.newest is not None:
            return
        last = recording.segments[-1]
        try:
            for packet in await self.bus.read_group(last.first, last.last):
                self.hub.send(await self.hub.decode(replace(packet, sequence=self._sequence)))
                self._sequence += 1
            away = time.time() - last.path.stat().st_mtime
        except (StreamlodError, OSError, ValueError) as error:
            _LOG.warning("stream %s: its last state cannot be shown: %s", self.id, error)
            return
        stored, newest = recording.stored, last.last
        if away < MAX_AWAY_SECONDS and stored.trained_from == self.etag and newest.epoch == stored.epoch:
            self._frames_done = max(0, newest.version + 1 - stored.lead)

    async def stop(self, *, remember: bool = True) -> None:
        """Stop the worker and finish the open segment; viewers stay.

        Args:
            remember: that it is not to be started with the server.
        """
        if remember:
            self._note(running=False)
        self._armed = False
        if self._pause is not None:
            self._pause.cancel()
        if self._pausing is not None:
            await self._pausing
        await self._end_worker()
        if self.state in {"starting", "live", "degraded"} or self.detail == _WAITS:
            self._enter("idle")

    async def _end_worker(self) -> None:
        self._stopping = True
        self._watched.set()
        if (task := self._task) is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            if self._task is task:  # and not one that was started since
                self._task = None
        self._stopping = False
        self._placed.set()  # nobody waits for a worker that will not come
        self.worker_node = ""
        if self.bus.recording is not None:
            await self.bus.recording.close()

    async def delete(self, *, erase: bool) -> None:
        """Stop for good, and erase the recording if wanted."""
        self.deleted = True  # so that nobody starts it again meanwhile
        await self.stop()
        if erase and self.bus.recording is not None:
            await self.bus.recording.erase()
        self.hub.wake()

    async def close(self) -> None:
        """Stop, and start again with the server."""
        await self.stop(remember=False)

    async def on_message(self, tag: Tag, body: bytes) -> None:
        """See `supervisor.Owner`."""
        if tag in {Tag.PACKET, Tag.PREVIEW}:
            await self._until_watched()
            await self._on_packet(body, record=tag is Tag.PACKET)
        elif tag is Tag.REPORT:
            self.report = json.loads(body)
            self._tell_stages(self.report.pop("stages", []) if self.report else [])
            self._frames_done = self.report.get("done", self._frames_done + 1) if self.report else 0
            if self.report:
                self._note(**self._training(self.report["version"]))
        elif tag is Tag.PROGRESS:
            self.progress = json.loads(body)
            self._tell(event("progress", **(self.progress or {})))
        elif tag is Tag.SOUND:
            self._hear(body)
        elif tag is Tag.INGEST:
            self._on_ingest(json.loads(body))
        elif tag is Tag.PICTURES:
            self.camera_pictures = self.camera_pictures | unpack_pictures(body)
        elif tag is Tag.PLACED:
            self._placed.set()
            self.worker_node = json.loads(body)["node"]
            _LOG.info("stream %s: its worker runs on node %s", self.id, self.worker_node)
        elif tag is Tag.EPOCH:
            self._new_epoch, self._frames_done = True, 0

    @property
    def waits_for_room(self) -> bool:
        """See `supervisor.Owner`. Who starts it by hand is told at once; what starts with the server waits."""
        return not self._askers

    async def resume_point(self) -> Resume:
        """See `supervisor.Owner`."""
        async with self._restoring:
            self._new_epoch, self.ingest = True, None
        if self._frames_done == 0:
            return Resume()
        return Resume(tuple(await self.hub.snapshot()), self._frames_done)

    def on_restart(self, ending: Ending, delay_seconds: float) -> None:
        """See `supervisor.Owner`."""
        _LOG.warning("stream %s: %s; restart in %g s", self.id, ending.text, delay_seconds)
        state = "degraded" if self.newest else "starting"
        self._placed.set()
        self.worker_node = ""
        self._enter(state, f"{ending.text}; it is being restarted")

    def on_finish(self, ending: Ending) -> None:
        """See `supervisor.Owner`."""
        _LOG.info("stream %s: %s", self.id, ending.refused.sentence(bool) if ending.refused else ending.text)
        if self.bus.recording is not None:
            asyncio.get_running_loop().create_task(self.bus.recording.close())
        self._note(trained_from="", **({"running": False} if ending.done else {}))
        self._refused = ending.refused
        self._placed.set()
        self.worker_node = ""
        self._enter("ended" if ending.done else "failed", ending.text)

    async def _until_watched(self) -> None:
        """Wait while a file is played that nobody watches or keeps; its worker, whose message this is, waits too."""
        is_wanted = self.viewers or self.bus.keeps or self.bus.outbox is not None or self._stopping
        if self.spec.play is None or self.state != "live" or is_wanted:
            return
        if time.monotonic() - self._unwatched_since < self._settings.on_demand_seconds:
            return
        self._watched.clear()
        self.is_paused = True
        await self._watched.wait()
        self.is_paused = False

    async def _on_packet(self, data: bytes, *, record: bool) -> None:
        """Decode a packet, record it, send it and retain it, in this order: nobody gets what is unusable or lost."""
        packet = stream_packet(self._sequence, self._epoch + self._new_epoch, data)
        timer = StageTimer()
        decoded = await self.hub.decode(packet)
        timer.end("decode")
        if record:
            self.sound_track.record_until(packet.info.time_ns)
            await self.bus.record(packet)
            timer.end("retain")
        self._begin_epoch(packet)
        self.hub.send(decoded, self._window_message())
        timer.end("send")
        self._publish(packet)
        if self.traces.listeners:
            self._untold.setdefault(packet.position, []).extend(timer.stages)
        if record:
            self._enter_live()

    def _tell_stages(self, told: list[tuple[str, int, int]]) -> None:
        """Report the stages of packets since the last report; `told` are the worker's for the newest of them."""
        untold, self._untold = self._untold, {}
        for position, stages in untold.items():
            worker = [Stage(*each) for each in told] if position == self.newest else []
            self.traces.tell(FrameStages(self.id, self.incarnation, position, worker, stages, is_origin=True))

    def _begin_epoch(self, first: StreamPacket) -> None:
        """Announce a new epoch at the moment its first packet becomes the newest.

        If it were announced earlier, a viewer that joins in between would be told the old epoch and never the new one.
        """
        if self._new_epoch:
            self._epoch, self._new_epoch = self._epoch + 1, False
            # before anybody sees its packets: no epoch is used twice
            self._note(epoch=self._epoch, **self._training(first.position.version))
            self._tell(event("epoch", epoch=self._epoch))

    def _training(self, version: int) -> dict[str, Any]:
        """The note to keep of training, whose newest frame became `version`."""
        if self.spec.job is None or self._frames_done == 0:
            return {"trained_from": ""}
        return {"trained_from": self.etag, "lead": version + 1 - self._frames_done}

    def _note(self, **changes: Any) -> None:
        """Remember something in the state folder, as far as the disk takes it."""
        if self.bus.recording is None:
            return
        try:
            self.bus.recording.note(**changes)
        except StorageError as error:
            _LOG.warning("stream %s: %s", self.id, error)

    def _on_ingest(self, figures: dict[str, Any]) -> None:
        self.ingest = figures
        if self.state == "starting":
            if (fault := complaint(figures)) != self.detail:
                _LOG.info("stream %s: starting: %s", self.id, fault or "all cameras deliver")
            self._enter("starting", fault)
        elif not self._new_epoch:  # until a restarted worker has sent a packet, the stream stays degraded
            self._enter_live()

    def _enter_live(self) -> None:
        """Live, or degraded while a camera is missing."""
        fault = complaint(self.ingest) if self.ingest else ""
        self._enter("degraded" if fault else "live", fault or (sound_fault(self.ingest) if self.ingest else ""))

    def _make_supervisor(self) -> Supervisor:
        settings = self._settings
        limit, pictures = settings.limits.packet_bytes, settings.camera_pictures
        entry = partial(run_on_ray, settings.ray, limit + 1) if self._in_cluster else None
        return Supervisor(self.spec, settings.worker, limit, self, self.push_socket, pictures, entry)
