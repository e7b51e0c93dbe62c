"""All streams of the server, and the parts that they share."""

from __future__ import annotations

import asyncio
import logging
import secrets
import tempfile
from collections import Counter
from pathlib import Path

from core.errors import InputError
from server.auth.gate import Gate
from server.pipeline.spec import StreamSpec, spec_from_json
from server.settings import Settings
from server.stream.store import Store
from server.stream.stream import Stream
from server.viewer.renderer import PictureRenderer
from server.viewer.session import ViewerSession

_LOG = logging.getLogger(__name__)


class Registry:
    """The running server's state.

    Args:
        settings: of the server.
        specs: streams to begin with; they are started when the server is up.

    Raises:
        InputError: two streams have one id, or the state folder cannot be used.
    """

    def __init__(self, settings: Settings, specs: tuple[StreamSpec, ...] = ()) -> None:
        self.settings = settings
        self.gate = Gate(settings)
        self.store = Store(settings.state, settings.retention) if settings.state else None
        self.streams: dict[str, Stream] = {}
        self.sessions: dict[ViewerSession, str] = {}  # with the viewer's address
        self.renderer = PictureRenderer(settings.limits.thin_viewers, settings.limits.thin_pixels)
        self.turned_away: Counter[str] = Counter()  # connections, by close code or fault
        self.draining = False
        self._drained = False
        self._sockets: tempfile.TemporaryDirectory[str] | None = None
        self._initial = [spec.id for spec in specs]
        for spec in specs:
            if spec.id in self.streams:
                raise InputError(f"stream {spec.id}", "two streams cannot have one id")
            self._add(spec)
        for name, definition in (self.store.definitions() if self.store else {}).items():
            if name in self.streams:
                continue
            try:
                self._add(spec_from_json(definition))
            except InputError as error:
                _LOG.warning("a remembered stream is left out: %s", error)

    def start(self) -> None:
        """Start the streams of the command line."""
        for name in self._initial:
            self.streams[name].start()

    async def create(self, spec: StreamSpec) -> Stream:
        """Add a stream, idle, and remember it.

        Raises:
            InputError: the id is taken, or there are too many streams.
        """
        if spec.id in self.streams:
            raise InputError(f"stream {spec.id}", "there is one of that id already")
        if len(self.streams) >= self.settings.limits.streams:
            raise InputError(f"stream {spec.id}", f"there are {len(self.streams)} streams, and no more are allowed")
        stream = self._add(spec)
        if self.store is not None:
            store = self.store
            await store.run(lambda: store.define(spec.id, spec.to_json()))
        return stream

    async def delete(self, name: str) -> None:
        """Remove a stream with its recording."""
        stream = self.streams.pop(name)
        await stream.delete()
        if self.store is not None:
            store = self.store
            await store.run(lambda: store.define(name, None))

    async def drain(self) -> None:
        """Disconnect viewers, stop workers and finish recordings; only the first call does anything."""
        self.draining = True
        if self._drained:
            return
        self._drained = True
        for session in self.sessions:
            session.draining = True
            session.wake.set()
        for stream in self.streams.values():
            stream.hub.wake()  # requests that wait for something new
        limit = asyncio.get_running_loop().time() + self.settings.drain_seconds / 2
        while self.sessions and asyncio.get_running_loop().time() < limit:
            await asyncio.sleep(0.02)
        self.renderer.close()
        await asyncio.gather(*(stream.stop() for stream in self.streams.values()), return_exceptions=True)
        if self.store is not None:
            await asyncio.to_thread(self.store.close)
        if self._sockets is not None:
            self._sockets.cleanup()

    def _add(self, spec: StreamSpec) -> Stream:
        recording = self.store.recording(spec.id) if self.store else None
        socket = self._push_socket() if spec.is_live else None
        self.streams[spec.id] = Stream(spec, self.settings, recording, socket)
        return self.streams[spec.id]

    def _push_socket(self) -> Path:
        """A place for a worker's socket in a folder that is this user's alone; its path may have 107 bytes."""
        if self._sockets is None:
            self._sockets = tempfile.TemporaryDirectory(prefix="streamlod-")
        return Path(self._sockets.name) / secrets.token_hex(8)
