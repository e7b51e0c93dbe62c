"""A stream whose packets a worker process makes: when its worker starts, waits for viewers and stops."""

from __future__ import annotations

import asyncio
import hashlib
import json
import secrets
import time
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from streamlod.codec.sound.beside import find_sound
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Bus
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import Traces
from streamlod.server.stream.worker.work import Work
from streamlod.server.worker.cluster.driver import run_on_ray
from streamlod.server.worker.supervisor import Supervisor

_WAITS = "it starts with its first viewer"


class WorkerStream(Stream):
    """A running or idle stream.

    Args:
        spec: what it is made from.
        settings: of the server.
        recording: its place on disk, or None.
        push_socket: where its worker takes pictures that capture nodes push, or None.
        feed, traces: where its states and the stages of its frames are told.

    Attributes:
        spec: what it is made from.
        work: what its workers do and have done.
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
        created_ns = recording.stored.created_ns if recording else time.time_ns()
        self.created_at = datetime.fromtimestamp(created_ns / 1e9, UTC)
        self.work = Work(self, settings.on_demand_seconds)
        self._armed = False  # whether the next viewer starts it
        self.define(spec, push_socket)
        self._supervisor = self._make_supervisor()
        self._task: asyncio.Task[None] | None = None
        self._parting: asyncio.TimerHandle | None = None  # runs while nobody watches a stream on demand
        self._retiring: asyncio.Task[None] | None = None  # ends its worker until somebody comes

    def define(self, spec: StreamSpec, push_socket: Path | None) -> None:
        """Make it from something else, from its first frame on; only while it does not run.

        One that waits for its first viewer starts now if it is not to wait any more.
        """
        self.spec, self.push_socket = spec, push_socket
        self.work.define(self.etag if spec.job else "", on_demand=spec.on_demand)
        self.source, self.played_file = spec.source, spec.play
        self.loop = spec.play is not None and spec.loop
        sound = None if spec.play is None else find_sound(spec.play)
        self.file_sound = None if sound is None else sound.facts(live=False)
        self._armed = self._armed and spec.on_demand
        if self.detail == _WAITS:
            self.start()

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
        self.note(running=True)
        self.work.placing.begin()
        self._armed = self.spec.on_demand
        if self._armed and not self.viewers:
            self.enter("idle", _WAITS)
        else:
            self._launch()

    async def until_placed(self, may_see: Callable[[str], bool]) -> str:
        """Wait, some seconds at most, until its worker has room in the cluster; at once where it needs none.

        Returns why there is no room, for somebody who may see such streams, and then it has failed; otherwise nothing.
        """
        return await self.work.placing.until_over(may_see, is_searching=self.is_running and self._in_cluster)

    def join(self) -> None:
        """A viewer has come; it may be what a stream on demand waits for."""
        super().join()
        self.work.pausing.join()
        if self._parting is not None:
            self._parting.cancel()
        if self._armed and not self.is_running and self._retiring is None:
            self._launch()

    def leave(self) -> None:
        """A viewer has gone; after the last one, a stream on demand stops for now."""
        super().leave()
        self.work.pausing.leave()
        if self._armed and not self.viewers:
            seconds = self._settings.on_demand_seconds
            self._parting = asyncio.get_running_loop().call_later(seconds, self._retire)

    async def stop(self, *, remember: bool = True) -> None:
        """Stop the worker and finish the open segment; viewers stay.

        Args:
            remember: that it is not to be started with the server.
        """
        if remember:
            self.note(running=False)
        self._armed = False
        if self._parting is not None:
            self._parting.cancel()
        if self._retiring is not None:
            await self._retiring
        await self._end_worker()
        if self.state in {"starting", "live", "degraded"} or self.detail == _WAITS:
            self.enter("idle")

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

    def _launch(self) -> None:
        self.work.begin()
        self.progress = None
        self.bus.keeps = self.bus.recording is not None and self.spec.recorded
        self._supervisor = self._make_supervisor()
        self.enter("starting")
        self._task = asyncio.create_task(self._supervisor.run())

    def _make_supervisor(self) -> Supervisor:
        settings = self._settings
        limit, pictures = settings.limits.packet_bytes, settings.camera_pictures
        entry = partial(run_on_ray, settings.ray, limit + 1) if self._in_cluster else None
        return Supervisor(self.spec, settings.worker, limit, self.work, self.push_socket, pictures, entry)

    @property
    def _in_cluster(self) -> bool:
        """Whether its worker runs in a cluster; one that plays a file does not: it needs the file and little else."""
        return self._settings.jobs == "ray" and self.spec.job is not None

    def _retire(self) -> None:
        if self._armed and not self.viewers and self._retiring is None and not self.deleted:
            self._retiring = asyncio.create_task(self._wait_for_viewers())

    async def _wait_for_viewers(self) -> None:
        await self._end_worker()
        self._retiring = None
        if self._armed and self.viewers:  # somebody came meanwhile
            self._launch()
        elif self._armed:
            self.enter("idle", _WAITS)

    async def _end_worker(self) -> None:
        self.work.pausing.end()
        if (task := self._task) is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            if self._task is task:  # and not one that was started since
                self._task = None
        self.work.placing.end()  # nobody waits for a worker that will not come
        if self.bus.recording is not None:
            await self.bus.recording.close()
