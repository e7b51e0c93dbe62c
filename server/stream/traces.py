"""When each stage of a frame's way ran, for whoever wants to know; nothing is kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from streamlod.server.protocol.packets import Position


@dataclass(frozen=True, slots=True)
class Stage:
    """A stage of a frame's way.

    Attributes:
        name: such as ``train`` or ``send``.
        begin_ns, end_ns: Unix time of the machine that it ran on.
    """

    name: str
    begin_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class FrameStages:
    """The stages of a frame's way that one server knows.

    Attributes:
        stream, incarnation, position: which frame; the same at every server that passes it on.
        worker: stages in the worker that made it; none at a server that only passes it on.
        server: stages in this server.
        is_origin: whether it was made here.
    """

    stream: str
    incarnation: str
    position: Position
    worker: Sequence[Stage]
    server: Sequence[Stage]
    is_origin: bool


class Traces:
    """Tells `listeners` the stages of each frame; they must not raise."""

    def __init__(self) -> None:
        self.listeners: set[Callable[[FrameStages], None]] = set()

    def tell(self, frame: FrameStages) -> None:
        """A frame has been passed on."""
        for listener in self.listeners:
            listener(frame)


class StageTimer:
    """Times stages that follow each other, from now on.

    Attributes:
        stages: that have ended.
    """

    def __init__(self) -> None:
        self.stages: list[Stage] = []
        self._begin_ns = time.time_ns()

    def end(self, name: str) -> None:
        """A stage ends, and the next one begins."""
        now_ns = time.time_ns()
        self.stages.append(Stage(name, self._begin_ns, now_ns))
        self._begin_ns = now_ns
