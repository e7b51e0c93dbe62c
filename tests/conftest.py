"""Shared fixtures. Real data lies in STREAMLOD_DATA; tests that need it skip, saying so, where it is absent."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import streamlod.core  # noqa: F401  first of all: it sets what torch and numba read when they load
from tests.device import pretend
from tests.device.fixture import gpu

__all__ = ["gpu"]

if pretend.can_be_registered():
    pretend.register()  # torch counts its devices when it first differentiates, so it must be there before that


def pytest_xdist_auto_num_workers() -> int:
    """Processes for ``-n auto``: one more than there are cores, since tests of servers and of the page often wait."""
    return len(os.sched_getaffinity(0)) + 1


def data_folder() -> Path | None:
    """The folder of real pictures and video, if this machine has it."""
    for candidate in (os.environ.get("STREAMLOD_DATA"), Path(__file__).parents[2] / "shared" / "data"):
        if candidate and Path(candidate).is_dir():
            return Path(candidate)
    return None


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real data, or a skip."""
    folder = data_folder()
    if folder is None:
        pytest.skip("no real data here: set STREAMLOD_DATA to the folder that holds it")
    return folder
