"""Actors that train a first frame of a few steps, for tests of what flows rather than of quality."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from core.train.presets import PRESETS, preset
from server.worker.cluster import actor, driver


class BriefActor(actor.WorkerActor):
    """Trains the preset `live` briefly."""

    def run(self, *arguments: Any) -> None:
        brief = preset("live")
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(PRESETS, "live", replace(brief, keyframe=replace(brief.keyframe, steps=12)))
            super().run(*arguments)


def run_on_ray(*arguments: Any) -> None:
    """`server.worker.cluster.driver.run_on_ray` with such an actor; in a process of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("server.worker.cluster.placing.WorkerActor", BriefActor)
        driver.run_on_ray(*arguments)
