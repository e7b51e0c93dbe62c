"""A worker process that trains on the pretend device: what a supervisor starts there in place of its own."""

from __future__ import annotations

from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import pytest

from streamlod.core.train.presets.named import PRESETS, preset
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.worker import process
from tests.device.fixture import on_gpu


def run_worker(spec: StreamSpec, pipe: Connection, *arguments: Any) -> None:
    """`server.worker.process.run_worker` on a GPU, with frames of a few steps; in a process of its own."""
    brief = preset("live")
    keyframe = replace(brief.keyframe, steps=12)
    brief = replace(brief, keyframe=keyframe, predict=replace(brief.predict, epochs=1, minimum_steps=4))
    with pytest.MonkeyPatch.context() as patch, on_gpu(patch):
        patch.setitem(PRESETS, "live", brief)
        process.run_worker(spec, pipe, *arguments)
