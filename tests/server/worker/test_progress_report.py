"""What is told while kernels are compiled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

from streamlod.core.train import Progress
from streamlod.server.pipeline.spec import spec_from_json
from streamlod.server.settings import Settings
from streamlod.server.worker.progress_report import COMPILING, ProgressReport
from tests.server.conftest import running


@njit
def _half(values: Any) -> Any:
    return values / 2


@njit
def _quarter(values: Any) -> Any:
    return _half(_half(values))


def test_compiling_is_told_once_and_then_what_was_told_before() -> None:
    told: list[Any] = []
    report = ProgressReport(told.append)
    with report.compiling():
        _quarter(np.ones(3))
        report.trained(Progress("first look", 0.25, 0.5))
        _quarter(np.ones(3, np.float32))
        _quarter(np.zeros(3))  # compiled already
    _quarter(np.ones((3, 3)))  # nobody listens
    look = {"fraction": 0.25, "loss": 0.5, "text": "first look"}
    assert told == [
        {"fraction": 0.0, "loss": 0.0, "text": COMPILING}, b"null",
        look, look | {"text": COMPILING}, look,
    ]  # fmt: skip


@pytest.mark.long
def test_the_first_start_on_a_machine_says_that_it_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    spec = spec_from_json({"synthetic": {"cameras": 3, "width": 64, "height": 36}})
    with running(Settings(), spec) as server:
        found = server.wait(lambda stream: stream["progress"] is not None)
        assert (found["state"], found["progress"]["text"]) == ("starting", COMPILING)
