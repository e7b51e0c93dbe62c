"""Shared fixtures. Real data lies in STREAMLOD_DATA; tests that need it skip, saying so, where it is absent."""

from __future__ import annotations

import gc
import importlib
import os
from collections.abc import Generator
from contextlib import suppress
from itertools import zip_longest
from pathlib import Path

import pytest

import streamlod.core  # noqa: F401  first of all: it sets what torch and numba read when they load

DEAR = ("browser", "cluster", "long")


def pytest_configure(config: pytest.Config) -> None:
    """Tests have a pretend GPU. A process that only hands tests out to others would load torch for nothing."""
    if hasattr(config, "workerinput") or config.getoption("dist", "no") == "no":
        from tests.device import fixture, pretend

        config.pluginmanager.register(fixture)
        if pretend.can_be_registered():
            pretend.register()  # torch counts its devices when it first differentiates, so it must be there before that


def pytest_xdist_auto_num_workers() -> int:
    """Processes for ``-n auto``: two more than there are cores, since tests of servers and of the page often wait."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Modules and tests stay to the end: searches for garbage go past them, which took a twentieth of all the time."""
    gc.disable()
    try:
        _read_modules(session.config)
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _read_modules(config: pytest.Config) -> None:
    """Workers read the modules of tests in turn from other places, and so find most of them read by another one.

    In a fresh checkout it takes longer to rewrite their assertions than to collect them, and each would do it for all.
    """
    worker = getattr(config, "workerinput", None)
    if worker is None or config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    paths = sorted(Path(__file__).parent.rglob("test_*.py"))
    first = len(paths) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
    for path in (*paths[first:], *paths[:first]):
        with suppress(Exception, pytest.skip.Exception):  # collection says what is wrong
            importlib.import_module(".".join(path.relative_to(Path(__file__).parents[1]).with_suffix("").parts))


@pytest.hookimpl(trylast=True)  # after those that are not wanted have gone
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files begin in turn with one of Chromium's, one of several servers and one of long tests; all others last.

    So those that wait stand beside those that compute, and what is left at the end is short: it fills all cores.
    """
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    queues: dict[str, list[tuple[int, list[pytest.Item]]]] = {kind: [] for kind in (*DEAR, "")}
    for tests in files.values():
        counts = {kind: sum(test.get_closest_marker(kind) is not None for test in tests) for kind in DEAR}
        kind = next((kind for kind in DEAR if counts[kind]), "")
        queues[kind].append((counts.get(kind, 0), tests))
    dear = [[tests for _, tests in sorted(queues[kind], key=lambda entry: -entry[0])] for kind in DEAR]
    in_turn = [tests for row in zip_longest(*dear, fillvalue=[]) for tests in row]
    items[:] = [test for tests in (*in_turn, *(tests for _, tests in queues[""])) for test in tests]


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
