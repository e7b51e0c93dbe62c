"""Restarts a stream's worker process on a crash, a heartbeat timeout or a memory limit, with growing delays."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import multiprocessing
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Protocol

from streamlod.core.errors import BitstreamError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import WorkerSettings
from streamlod.server.worker.cluster.room import Shortage
from streamlod.server.worker.messages import Resume, Tag, send_resume
from streamlod.server.worker.process import resident_bytes, run_worker
from streamlod.server.worker.running_time import RunningTime

_LOG = logging.getLogger(__name__)
_WATCH_SECONDS = 0.25
_MAX_DOUBLINGS = 20  # of the delay between two attempts
_SPARE_AFTER_SECONDS = 3.0  # of progress first, because a starting worker needs the whole processor


@dataclass(frozen=True, slots=True)
class Ending:
    """How a worker ended: `text` for people, `done` at the source's end, `fatal` when a restart would not help.

    `refused`: it never began, as the cluster has no room for it, and why.
    """

    text: str
    done: bool = False
    fatal: bool = False
    refused: Shortage | None = None


@dataclass(frozen=True, slots=True)
class _Worker:
    """A process, and our end of its pipe. It waits until it is told where to continue."""

    process: SpawnProcess
    pipe: Connection

    def end(self) -> None:
        """Kill it."""
        if self.process.is_alive():
            self.process.kill()


class Owner(Protocol):
    """Whoever a supervisor reports to."""

    async def on_message(self, tag: Tag, body: bytes) -> None:
        """Handle one message; the worker waits until this returns."""

    @property
    def waits_for_room(self) -> bool:
        """Whether a worker for which a cluster has no room is tried again, however often, as nodes may come."""

    async def resume_point(self) -> Resume:
        """Where the next worker continues."""

    def on_restart(self, ending: Ending, delay_seconds: float) -> None:
        """A worker ended and another one will be started."""

    def on_finish(self, ending: Ending) -> None:
        """A worker ended and no other one will be started."""


class Supervisor:
    """Runs workers for one stream, one at a time.

    Args:
        spec: what they work on.
        settings: how they are watched.
        packet_bytes: longest message that is accepted.
        owner: gets all messages and events.
        push_socket: where workers take pictures that capture nodes push, or none.
        camera_pictures: whether they send what the cameras see.
        entry: what runs in a worker's process, in place of `run_worker`.
    """

    def __init__(
        self,
        spec: StreamSpec,
        settings: WorkerSettings,
        packet_bytes: int,
        owner: Owner,
        push_socket: Path | None = None,
        camera_pictures: bool = False,
        entry: Callable[..., None] | None = None,
    ) -> None:
        self._entry = entry
        self._spec, self._settings, self._owner = spec, settings, owner
        self._limit, self._push_socket, self._camera_pictures = packet_bytes + 1, push_socket, camera_pictures
        self._worker: _Worker | None = None
        self._spare: _Worker | None = None  # a second process, waiting with everything loaded
        self._clock = RunningTime(_WATCH_SECONDS)
        self._heard = self._progressed = 0.0
        self._ending: Ending | None = None
        self._handling = False
        self._spoke: float | None = None  # when its worker was first heard: it has loaded its code
        self._reported = 0  # bytes of memory, of the worker
        self.restarts = 0

    @property
    def pid(self) -> int | None:
        """Process id of the worker, while there is one."""
        return self._worker.process.pid if self._worker is not None else None

    async def run(self) -> None:
        """Run workers until the source ends, an ending is fatal, or this task is cancelled."""
        failures = 0
        try:
            while True:
                begun = self._progressed = self._clock.now()
                try:
                    ending = await self._run_once()
                except Exception as error:
                    _LOG.exception("stream %s: its worker could not be run", self._spec.id)
                    ending = Ending(f"the worker could not be run ({error})")
                failures = 1 if self._progressed > begun else failures + 1
                patient = ending.refused is not None and self._owner.waits_for_room
                if ending.done or ((ending.fatal or failures > self._settings.attempts) and not patient):
                    self._owner.on_finish(ending)
                    return
                delay = self._settings.first_delay_seconds * 2.0 ** min(failures - 1, _MAX_DOUBLINGS)
                delay = min(delay, self._settings.longest_delay_seconds)
                self.restarts += 1
                self._owner.on_restart(ending, delay)
                await asyncio.sleep(delay)
        finally:
            self._kill()
            if self._spare is not None:
                self._spare.end()
                self._spare.pipe.close()
                await asyncio.shield(asyncio.to_thread(self._spare.process.join, 5))

    async def _run_once(self) -> Ending:
        spare, self._spare = self._spare, None
        worker = self._worker = spare if spare is not None and spare.process.is_alive() else self._start()
        try:
            resume = await self._owner.resume_point()  # a new process loads its code meanwhile
        except BaseException:
            self._kill()
            worker.pipe.close()
            await asyncio.shield(asyncio.to_thread(worker.process.join, 5))
            raise
        self._clock.begin()
        self._ending, self._heard, self._spoke, self._reported = None, self._clock.now(), None, 0
        begun = self._heard
        loop = asyncio.get_running_loop()
        thread = ThreadPoolExecutor(1, thread_name_prefix=f"pump-{self._spec.id}")  # the shared pool may be in use
        pump = loop.run_in_executor(thread, self._pump, worker.pipe, resume, loop)
        reason = None
        try:
            while not pump.done():
                await asyncio.wait([pump], timeout=_WATCH_SECONDS)
                self._clock.turn()
                if self._spare is None and self._wants_spare and self._progressed > begun + _SPARE_AFTER_SECONDS:
                    self._spare = self._start(spare=True)
                reason = reason or self._complaint()
                if reason is not None:
                    self._kill()
            await pump
        finally:
            self._kill()
            try:
                await asyncio.shield(asyncio.wait([pump], timeout=2))
            finally:  # a cancellation that comes here must end `run` as well
                worker.pipe.close()
                thread.shutdown(wait=False)
                await asyncio.shield(asyncio.to_thread(worker.process.join, 5))
        return self._last_words() or Ending(reason or f"the worker ended by {_cause(worker.process.exitcode)}")

    @property
    def _wants_spare(self) -> bool:
        """Whether to keep a spare process; a worker that plays a file needs none, as it loads nothing slow."""
        return self._settings.spare and self._spec.job is not None

    def _start(self, *, spare: bool = False) -> _Worker:
        """Start a process; not on a thread, so that a cancellation cannot leave it running unnoticed."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        name = f"streamlod-{self._spec.id}"
        arguments = (self._spec, theirs, self._push_socket, spare, self._camera_pictures)
        process = context.Process(target=self._entry or run_worker, args=arguments, name=name, daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)

    def _last_words(self) -> Ending | None:
        """The reason that the worker itself reported for its end, if any."""
        return self._ending

    def _pump(self, pipe: Connection, resume: Resume, loop: asyncio.AbstractEventLoop) -> None:
        """Read messages on a thread; each is handled before the next is read (backpressure on the worker)."""
        with contextlib.suppress(OSError):  # the cause of its end is determined below
            send_resume(resume, pipe)
        while True:
            try:
                message = pipe.recv_bytes(self._limit)
            except (EOFError, OSError):
                return
            tag, body = Tag(message[0]), message[1:]
            self._heard = self._clock.now()
            if self._spoke is None and tag is not Tag.PLACED:  # else its actor has not started yet
                self._spoke = self._heard
            if tag is Tag.HEARTBEAT:
                self._reported = int.from_bytes(body)
                continue
            if tag is Tag.END:
                self._ending = Ending("the source has ended", done=True)
            elif tag is Tag.FAILURE:
                failure: dict[str, Any] = json.loads(body)
                found = failure.get("refused")
                refused = Shortage(found["text"], tuple(map(tuple, found["ways"]))) if found else None
                self._ending = Ending(failure["text"], fatal=failure["fatal"], refused=refused)
            else:
                self._handling = True
                handled: Awaitable[None] = self._owner.on_message(tag, body)
                try:
                    asyncio.run_coroutine_threadsafe(_await(handled), loop).result()
                    if _is_progress(tag, body):
                        self._progressed = self._clock.now()
                except Exception as error:
                    of_file = self._spec.play is not None and isinstance(error, BitstreamError | ValueError)
                    if of_file:  # which stays as it is
                        self._ending = Ending(f"{self._spec.play} cannot be decoded ({error})", fatal=True)
                    else:
                        _LOG.exception("stream %s: a message of the worker is refused", self._spec.id)
                        self._ending = Ending(f"the worker sent something unusable ({error})")
                    return
                finally:
                    self._heard, self._handling = self._clock.now(), False

    def _complaint(self) -> str | None:
        """Why the worker has to be killed, or None."""
        now = self._clock.now()
        if self._handling:  # heartbeats are queued behind the message that is being handled
            return None
        if self._spoke is None:  # loading takes longer than any silence later, on a busy machine above all
            if now - self._heard > self._settings.start_seconds:
                return f"the worker did not start within {self._settings.start_seconds:g} s"
        elif now - self._heard > self._settings.heartbeat_seconds:
            return f"the worker was silent for {self._settings.heartbeat_seconds:g} s"
        elif now - max(self._spoke, self._progressed) > self._settings.stall_seconds:
            return f"the worker made no progress for {self._settings.stall_seconds:g} s"
        used = max(resident_bytes(self.pid), self._reported)  # an actor may run on another machine
        if used > self._settings.memory_bytes:
            return f"the worker took {used / 1e6:.0f} MB of memory"
        return None

    def _kill(self) -> None:
        if self._worker is not None:
            self._worker.end()


async def _await(handled: Awaitable[None]) -> None:
    await handled


_OF_NO_PROGRESS = frozenset({Tag.PICTURES, Tag.PLACED, Tag.MICROPHONE})


def _is_progress(tag: Tag, body: bytes) -> bool:
    """Whether a message shows that the worker gets on; waiting for pictures counts, having read some does not."""
    return tag not in _OF_NO_PROGRESS and (tag is not Tag.INGEST or json.loads(body)["waiting"] is True)


def _cause(exit_code: int | None) -> str:
    if exit_code is not None and exit_code < 0:
        return f"signal {-exit_code}"
    return f"exit code {exit_code}"
