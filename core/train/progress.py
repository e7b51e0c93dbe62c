"""Reports of training while it runs, and its results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from streamlod.core.arrays import Bool
from streamlod.core.scene.anchors import Scene
from streamlod.core.scene.residual import Residual


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a long run stands.

    Attributes:
        stage: for people, for example ``first frame``.
        fraction: done, in [0, 1].
        loss: of the latest step.
        preview: makes the scene as it is now; costs time, so call it only when someone looks.
    """

    stage: str
    fraction: float
    loss: float
    preview: Callable[[], Scene] | None = None


ProgressCallback = Callable[[Progress], None]


@dataclass(frozen=True, slots=True)
class FrameReport:
    """Figures of one trained frame.

    Attributes:
        seconds: wall time by stage.
        steps: training steps taken.
        anchors: anchors alive; dynamic: those that were trained.
        loss: mean loss of the last epoch.
        repaired: parameters that became non-finite and were reset.
        spans: each stage's name, begin and end in seconds of `time.perf_counter`.
    """

    seconds: dict[str, float]
    steps: int
    anchors: int
    dynamic: int
    loss: float
    repaired: int = 0
    spans: tuple[tuple[str, float, float], ...] = ()

    @property
    def total_seconds(self) -> float:
        """All stages together."""
        return sum(self.seconds.values())


@dataclass(frozen=True, slots=True, eq=False)
class TrainedFrame:
    """One frame, ready to encode.

    Attributes:
        scene: the state after it.
        residual: what changed; None where the state is a keyframe.
        report: figures.
        dynamic: [N] bool, which anchors of the state before were trained, over all levels; None for a keyframe.
    """

    scene: Scene
    residual: Residual | None
    report: FrameReport
    dynamic: Bool | None = None


@dataclass(slots=True)
class Stopwatch:
    """Adds up time by stage, as `clock` tells it in seconds."""

    clock: Callable[[], float] = time.perf_counter
    seconds: dict[str, float] = field(default_factory=dict)
    spans: list[tuple[str, float, float]] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time inside the block to `name`."""
        begin = self.clock()
        try:
            yield
        finally:
            end = self.clock()
            self.seconds[name] = self.seconds.get(name, 0.0) + end - begin
            self.spans.append((name, begin, end))
