"""Honest viewers of several streams in one process: they read, acknowledge, and count what they miss."""

from __future__ import annotations

import contextlib
import itertools
import json
import select
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

from tests.bench.fanout_viewers import Viewer, join

_ACK_SECONDS = 0.8


@dataclass(frozen=True, slots=True)
class Watched:
    """What all viewers of a stream together have seen so far.

    Attributes:
        packets: that came.
        missed: versions that did not come after the viewer had caught up, with no event that says so.
        skips: events that say so: the viewer, or the server, was too slow.
        closed: connections that ended, with their reasons.
    """

    packets: int = 0
    missed: int = 0
    skips: int = 0
    closed: tuple[str, ...] = ()


@dataclass(slots=True)
class Honest(Viewer):
    """A viewer that knows which version comes next."""

    stream: str = ""
    last: int | None = None  # version, once it has caught up
    following: bool = False
    told: bool = True  # that versions are left out, or begin anew
    seen: int = 0
    missed: int = 0
    skips: int = 0

    def take_text(self, text: bytes) -> None:
        name = json.loads(text).get("event")
        self.following = self.following or name == "caught_up"
        self.told = self.told or name in {"epoch", "levels", "skipped"}
        self.skips += name == "skipped"

    def complete(self) -> int:
        version = Viewer.complete(self)
        self.seen += 1
        expected = self.last is None or version in {self.last, self.last + 1}
        self.missed += not (expected or self.told)
        self.told = self.told and self.is_key  # a residual over what was told may follow that
        self.last = version if self.following else None
        return version


def watch(pipe: Connection, port: int, count: int, streams: tuple[str, ...]) -> None:
    """Main function of their process: follow `streams` in turn; "collect" is answered by `Watched` by stream."""
    poll = select.epoll()
    poll.register(pipe.fileno(), select.EPOLLIN)
    viewers: dict[int, Honest] = {}
    closed: dict[str, list[str]] = {stream: [] for stream in streams}
    totals = {stream: [0, 0, 0] for stream in streams}  # of viewers that were closed
    for _, stream in zip(range(count), itertools.cycle(streams), strict=False):
        viewer = Honest(join(port, stream=stream), stream=stream)
        viewers[viewer.peer.fileno()] = viewer
        poll.register(viewer.peer.fileno(), select.EPOLLIN)
    pipe.send(None)
    while True:
        for descriptor, _ in poll.poll(0.25, 512):
            if descriptor == pipe.fileno():
                if pipe.recv() is None:
                    return
                pipe.send({stream: _total(stream, viewers, totals, closed) for stream in streams})
                continue
            viewer = viewers[descriptor]
            try:
                viewer.pump()
            except OSError as error:
                closed[viewer.stream].append(viewer.reason or str(error))
                totals[viewer.stream][0] += viewer.seen
                totals[viewer.stream][1] += viewer.missed
                totals[viewer.stream][2] += viewer.skips
                poll.unregister(descriptor)
                del viewers[descriptor]
        now = time.monotonic()
        for viewer in viewers.values():
            if viewer.packets and now - viewer.acked_at > _ACK_SECONDS:  # also while nothing more comes
                with contextlib.suppress(OSError):
                    viewer.acknowledge(now)


def _total(
    stream: str, viewers: dict[int, Honest], totals: dict[str, list[int]], closed: dict[str, list[str]]
) -> Watched:
    here = [viewer for viewer in viewers.values() if viewer.stream == stream]
    packets = totals[stream][0] + sum(viewer.seen for viewer in here)
    missed = totals[stream][1] + sum(viewer.missed for viewer in here)
    skips = totals[stream][2] + sum(viewer.skips for viewer in here)
    return Watched(packets, missed, skips, tuple(closed[stream]))
