"""All streams of the server, and the parts that they share."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from streamlod.core.close_codes import CloseCode
from streamlod.core.errors import InputError, SessionError, StorageError, StreamGoneError
from streamlod.server.api.reach import check_reach
from streamlod.server.auth.gate import EVERYTHING, Gate
from streamlod.server.ingest.push.socket_folder import SocketFolder
from streamlod.server.pipeline.spec import StreamSpec, spec_from_json
from streamlod.server.settings import Settings
from streamlod.server.stream.bus import Outbox
from streamlod.server.stream.feed import Feed
from streamlod.server.stream.recording.recording import Recording
from streamlod.server.stream.recording.store import Store
from streamlod.server.stream.stream import Stream
from streamlod.server.stream.traces import Traces
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.viewer.renderer import PictureRenderer
from streamlod.server.viewer.session import ViewerSession
from streamlod.server.viewer.thin_session import ThinSession

_LOG = logging.getLogger(__name__)
_RETAIN_SECONDS = 30.0  # between two looks for what is too old
STOPPING = "the server is stopping; connect again"


class Registry:
    """The running server's state.

    Args:
        settings: of the server.
        specs: streams to begin with; they are started when the server is up.
        outbox: makes what a stream's packets leave by for other servers.

    Raises:
        InputError: two streams have one id, or the state folder cannot be used.
    """

    def __init__(
        self,
        settings: Settings,
        specs: tuple[StreamSpec, ...] = (),
        outbox: Callable[[Stream], Outbox] | None = None,
    ) -> None:
        self.settings, self._outbox = settings, outbox
        self.started_at = datetime.now(UTC)
        self.gate = Gate(settings)
        self.feed = Feed()
        self.traces = Traces()
        self.configured = frozenset(spec.id for spec in specs)  # which only the settings can change
        self.store = Store(settings.state, settings.retention) if settings.state else None
        self.streams: dict[str, Stream] = {}
        self._locks: dict[str, tuple[asyncio.Lock, int]] = {}  # of ids, with how many use each
        self.sessions: dict[ViewerSession | ThinSession, str] = {}  # with the viewer's address
        self.publishers: set[asyncio.Task[Any]] = set()  # sessions of capture nodes
        self.renderer = PictureRenderer(settings.limits.thin_viewers, settings.limits.thin_pixels)
        self.turned_away: Counter[str] = Counter()  # connections, by close code or fault
        self.edges = settings.edges  # where the same streams can be watched; an edge has those of its origin
        self.draining = False
        self.unready = ""  # why viewers should not come yet
        self.on_change: Callable[[Settings], None] = lambda settings: None  # of what runs beside, before it is taken
        self.stopping = asyncio.Event()  # set when viewers and capture nodes are disconnected
        self._drained = False
        self._sockets: SocketFolder | None = None
        self.kept: dict[str, Recording] = {}  # recordings of streams that were deleted
        idle = {new.id for new in settings.streams if new.start is False}
        self._initial = [spec.id for spec in specs if spec.id not in idle]
        for spec in specs:
            if spec.id in self.streams:
                raise InputError(f"stream {spec.id}", "two streams have this id; give each its own")
            self._add(spec)
        if self.store is not None:
            self._add_stored(self.store)
        self._tasks: set[asyncio.Task[None]] = set()

    def adopt(self, settings: Settings) -> None:
        """Use the limits and webhooks of other settings from now on; the rest of them holds from the next start.

        Raises:
            InputError: a webhook's secret cannot be used; nothing has changed.
        """
        changed = self.settings.model_copy(update={"limits": settings.limits, "webhooks": settings.webhooks})
        self.on_change(changed)
        self.settings = changed
        self.gate.limit_refusals(changed.limits.refusals_per_minute)
        self.renderer.limit(changed.limits.thin_viewers, changed.limits.thin_pixels)

    def start(self) -> None:
        """Show every stream's last state, and start those of the settings and those that ran before."""
        for name, stream in self.streams.items():
            if isinstance(stream, WorkerStream):
                self.spawn(self._begin(stream, start=name in self._initial))
        if self.store is not None:
            self.spawn(self._retain(self.store))

    async def create(self, spec: StreamSpec, *, start: bool = False) -> WorkerStream:
        """Add a stream, remember it, and start it if wanted.

        Raises:
            InputError: the id is taken, or there are too many streams.
            StorageError: the disk is full; nothing was added.
        """
        async with self._changing(spec.id):
            if self.draining:
                raise InputError(f"stream {spec.id}", "cannot be created while the server stops; try again later")
            if spec.id in self.streams:
                raise InputError(f"stream {spec.id}", "the id is taken; choose another")
            if len(self.streams) >= self.settings.limits.streams:
                raise InputError(f"stream {spec.id}", f"there are {len(self.streams)} streams, and no more are allowed")
            if self.store is not None and not self.store.disk.has_room:
                raise StorageError(f"stream {spec.id}", "cannot be stored: the disk is full up to its reserve")
            stream = self._add(spec)
            recording = stream.bus.recording
            if recording is not None:
                try:
                    recording.note(definition=self._sealed(spec), running=start)
                except StorageError:
                    del self.streams[spec.id]
                    if recording.segments:  # of an earlier stream of this id
                        self.kept[spec.id] = recording
                    else:
                        await recording.erase()
                    raise
            self.feed.tell("stream.created", spec.id)
            if start:
                stream.start()
            return stream

    async def delete(self, stream: WorkerStream, *, erase: bool) -> None:
        """Remove a stream, with its recording if that is to be erased.

        Its id is free when this is done, and not before.

        Raises:
            StreamGoneError: somebody else has deleted it.
            StorageError: this cannot be remembered, as the disk is full; the stream is as it was.
        """
        async with self._changing(stream.id):
            self._check_present(stream)
            recording = stream.bus.recording
            if recording is not None and not erase:
                recording.note(definition=None, running=False)
            try:
                await stream.delete(erase=erase)
            finally:  # it has stopped for good, whatever of it cannot be erased
                del self.streams[stream.id]
                self.configured -= {stream.id}  # whoever makes one of this id now may change it
            if recording is not None and not erase:
                self.kept[stream.id] = recording
            self.feed.tell("stream.deleted", stream.id, erased=erase)

    async def start_stream(self, stream: WorkerStream) -> None:
        """Start a stream's worker; one that runs goes on.

        Raises:
            StreamGoneError: it was deleted.
            InputError: the server stops, or the settings do not allow any more what the stream reaches.
        """
        async with self._changing(stream.id):
            self._check_present(stream)
            if self.draining:
                raise InputError(f"stream {stream.id}", "cannot be started while the server stops; try again later")
            if stream.id not in self.configured:  # whoever created it was allowed to; the settings may have changed
                check_reach(stream.spec, self.settings, EVERYTHING)
            stream.start()

    async def stop_stream(self, stream: WorkerStream) -> None:
        """Stop a stream's worker.

        Raises:
            StreamGoneError: it was deleted.
        """
        async with self._changing(stream.id):
            self._check_present(stream)
            await stream.stop()

    async def erase_kept(self, name: str) -> bool:
        """Erase the recording of a stream that was deleted; returns whether there was one."""
        async with self._changing(name):
            recording = self.kept.pop(name, None)
            if recording is not None:
                await recording.erase()
            return recording is not None

    @contextlib.asynccontextmanager
    async def _changing(self, name: str) -> AsyncIterator[None]:
        """Wait until nobody else creates, starts, stops, changes or deletes the stream of this id."""
        lock, waiting = self._locks.get(name, (asyncio.Lock(), 0))
        self._locks[name] = lock, waiting + 1
        try:
            async with lock:
                yield
        finally:
            lock, waiting = self._locks.pop(name)
            if waiting > 1:
                self._locks[name] = lock, waiting - 1

    def _check_present(self, stream: WorkerStream) -> None:
        """Refuse what is meant for a stream that is gone, whatever has its id now."""
        if self.streams.get(stream.id) is not stream:
            raise StreamGoneError(f"stream {stream.id}", "was deleted by somebody else")

    async def change(self, stream: WorkerStream, spec: StreamSpec) -> None:
        """Make a stream from something else, from its next start on.

        Raises:
            InputError: it runs, or belongs to the settings.
            StreamGoneError: it was deleted.
            StorageError: this cannot be remembered, as the disk is full; the stream is as it was.
        """
        async with self._changing(stream.id):
            self._check_present(stream)
            if stream.id in self.configured:
                raise InputError(f"stream {stream.id}", "is of the settings; change it there")
            if stream.is_running:
                raise InputError(f"stream {stream.id}", "runs; stop it before it is changed")
            if stream.bus.recording is not None:
                stream.bus.recording.note(definition=self._sealed(spec))
            stream.define(spec, self._push_socket() if spec.is_live else None)
            self.feed.tell("stream.changed", stream.id)

    async def drain(self) -> None:
        """Disconnect viewers and capture nodes, stop workers and finish recordings; only the first call does anything.

        Where there are edges, viewers are told so and served until they have gone there, for a while.
        """
        self.draining = True
        if self._drained:
            return
        self._drained = True
        if self.edges:
            for session in self.sessions:
                session.drain()
            await self._wait_for_leaving(self.settings.drain_seconds / 4)
        for session in self.sessions:
            session.end(SessionError(CloseCode.STOPPING, STOPPING))
        self.stopping.set()
        for stream in self.streams.values():
            stream.hub.wake()  # requests that wait for something new
        await self._wait_for_leaving(self.settings.drain_seconds / 2)
        self.renderer.close()
        for task in self._tasks:
            task.cancel()
        stops = (self._close(stream) for stream in list(self.streams.values()))
        await asyncio.gather(*self._tasks, *stops, return_exceptions=True)
        if self.store is not None:
            await asyncio.to_thread(self.store.close)
        if self._sockets is not None:
            self._sockets.close()

    async def _close(self, stream: Stream) -> None:
        async with self._changing(stream.id):
            await stream.close()

    async def _wait_for_leaving(self, seconds: float) -> None:
        """Wait until viewers have gone, and capture nodes once they are told to; for so long at most."""
        loop = asyncio.get_running_loop()
        limit = loop.time() + seconds
        while (self.sessions or (self.stopping.is_set() and self.publishers)) and loop.time() < limit:
            await asyncio.sleep(0.02)

    def _add(self, spec: StreamSpec) -> WorkerStream:
        recording = self.kept.pop(spec.id, None)
        if recording is None and self.store is not None:
            recording = self.store.recording(spec.id)
        socket = self._push_socket() if spec.is_live else None
        stream = self.streams[spec.id] = WorkerStream(spec, self.settings, recording, socket, self.feed, self.traces)
        stream.bus.outbox = None if self._outbox is None else self._outbox(stream)
        return stream

    def _sealed(self, spec: StreamSpec) -> Any:
        return self.store.seal.close(spec.to_json()) if self.store is not None else None

    def _add_stored(self, store: Store) -> None:
        """Streams that were created over REST, and recordings of those that were deleted since."""
        for name, stored in store.stored_streams().items():
            if name in self.streams:
                continue
            try:
                if stored.definition is None:
                    self.kept[name] = store.recording(name)
                else:
                    stream = self._add(spec_from_json(store.seal.open(stored.definition)))
                    self._initial += [name] if stored.running else []
                    check_reach(stream.spec, self.settings, EVERYTHING)
            except InputError as error:
                if (found := self.streams.get(name)) is None:
                    _LOG.warning("a remembered stream is left out: %s", error)
                else:  # settings were tightened since
                    _LOG.warning("stream %s may not run any more: %s", name, error)
                    self._initial = [each for each in self._initial if each != name]
                    found.enter("failed", str(error))

    async def _begin(self, stream: WorkerStream, *, start: bool) -> None:
        restoring = asyncio.create_task(stream.work.restore())
        await asyncio.sleep(0)  # it has begun; the worker loads its code meanwhile, and continues from what is restored
        if start:
            with contextlib.suppress(InputError):  # deleted already, or the server stops
                await self.start_stream(stream)
        await restoring

    async def _retain(self, store: Store) -> None:
        while True:
            await asyncio.sleep(min(_RETAIN_SECONDS, self.settings.retention.seconds))
            store.retain()

    def spawn(self, work: Coroutine[None, None, None]) -> None:
        """Do `work` until it is done or the server stops."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _push_socket(self) -> Path:
        """A place for a worker's socket."""
        if self._sockets is None:
            self._sockets = SocketFolder()
        return self._sockets.new_socket()
