"""Actors for tests of what flows rather than of quality: one plays a file, one trains a first frame of a few steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker import process
from streamlod.server.worker.cluster import actor, driver, placing


class PlayingActor(actor.WorkerActor):
    """Plays the recorded file that the job names as its data, once."""

    def run(self, spec: StreamSpec, *arguments: Any) -> None:
        assert spec.job is not None
        super().run(StreamSpec(spec.id, play=spec.job.data, loop=False), *arguments)


class BriefActor(actor.WorkerActor):
    """Trains the preset `live` briefly."""

    def run(self, *arguments: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(actor, "run_worker", _train_briefly)
            super().run(*arguments)


def _train_briefly(*arguments: Any) -> None:
    from streamlod.core.train.presets.named import PRESETS, preset  # numba with it, which counts its threads once

    brief = preset("live")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "live", replace(brief, keyframe=replace(brief.keyframe, steps=12)))
        process.run_worker(*arguments)


def play_on_ray(*arguments: Any) -> None:
    """`server.worker.cluster.driver.run_on_ray` with an actor that plays; in a process of its own."""
    _run(PlayingActor, arguments)


def play_on_ray_or_not(*arguments: Any) -> None:
    """The same, which gives up to find room as soon as a server does."""
    _run(PlayingActor, arguments, placing._SECONDS)


def train_on_ray(*arguments: Any) -> None:
    """The same with an actor that trains."""
    _run(BriefActor, arguments)


def _run(kind: type[actor.WorkerActor], arguments: tuple[Any, ...], seconds: float = 10.0) -> None:
    """Run an actor of `kind` for which room is looked for so long; a busy machine finds it late."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(placing, "WorkerActor", kind)
        patch.setattr(placing, "_SECONDS", seconds)
        driver.run_on_ray(*arguments)
