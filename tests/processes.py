"""Tests in several processes that share one collection: ``pytest --processes 4``, or ``auto``.

To import and collect all tests takes as long as a thousand of them. So that is done once, and the processes that run
them are copies of the one that did it (`os.fork`), which take file after file from a pipe until that is empty.
"""

from __future__ import annotations

import gc
import os
import threading
import traceback
from collections.abc import Iterator
from itertools import chain, groupby, pairwise
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import pytest

_NUMBER_BYTES = 2


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of how many processes run the tests."""
    parser.addoption("--processes", type=_count, default=1, help="run the files of tests in so many processes, or auto")


def _count(text: str) -> int:
    """How many processes: ``auto`` is two more than cores, since tests of servers and of the page often wait."""
    return len(os.sched_getaffinity(0)) + 2 if text == "auto" else int(text)


class _Sender:
    """Hands what a test reports to the process that shows it."""

    def __init__(self, config: pytest.Config, there: Connection) -> None:
        self._config, self._there = config, there

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._there.send(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        hook = self._config.hook
        self._there.send(hook.pytest_report_to_serializable(config=self._config, report=report))


def _taken(files: list[list[pytest.Item]], queue: int) -> Iterator[pytest.Item]:
    """The tests of the files whose numbers this process takes from the queue."""
    while number := os.read(queue, _NUMBER_BYTES):
        yield from files[int.from_bytes(number)]


def _run(session: pytest.Session, files: list[list[pytest.Item]], queue: int, there: Connection) -> None:
    """Run files of tests in a copy of the process until none is left, and end."""
    status = 1
    try:
        plugins = session.config.pluginmanager
        plugins.unregister(name="terminalreporter")
        capture = plugins.getplugin("capturemanager")
        capture.stop_global_capturing()  # into files that the copies would share
        capture.start_global_capturing()
        plugins.register(_Sender(session.config, there))
        for item, following in pairwise(chain(_taken(files, queue), (None,))):
            assert item is not None
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.shouldfail:
                break
        there.send(None)
        status = 0
    except BaseException:  # whatever it is, this copy must not go on with what the first process does next
        session.config.pluginmanager.getplugin("capturemanager").stop_global_capturing()
        traceback.print_exc()
    os._exit(status)


def _show(session: pytest.Session, connections: list[Connection], queue: int) -> None:
    """Report what the copies send until each has said that it is done, or is gone; after a stop they take no more."""
    hook = session.config.hook
    running = dict.fromkeys(connections, "")
    while running:
        for here in wait(list(running)):
            assert isinstance(here, Connection)
            try:
                message: Any = here.recv()
            except EOFError:
                session.shouldfail = f"a process died in {running[here]}"
                message = None
            if message is None:
                del running[here]
            elif isinstance(message, str):
                running[here] = message
            else:
                report = hook.pytest_report_from_serializable(config=session.config, data=message)
                hook.pytest_runtest_logreport(report=report)
        if session.shouldfail:
            _empty(queue)


def _empty(queue: int) -> None:
    while os.read(queue, 1 << 16):
        pass


def _threads() -> int:
    """How many threads there are, those of libraries as well where the system tells."""
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.exists() else threading.active_count()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    """Run the tests in copies of this process, where more than one is asked for."""
    count = session.config.option.processes
    if count < 2 or session.config.option.collectonly or session.testsfailed:
        return None
    assert _threads() == 1, "threads do not live on in a copy: start them in a test or a fixture, not on import"
    files = [list(tests) for _, tests in groupby(session.items, lambda item: item.path)]
    queue, end = os.pipe()
    os.write(end, b"".join(number.to_bytes(_NUMBER_BYTES) for number in range(len(files))))
    os.close(end)
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    reporter.showfspath = False
    session.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]  # one for all
    connections, children = list[Connection](), list[int]()
    gc.freeze()  # or each copy's first collection would write to all pages that it shares
    try:
        for _ in range(count):
            here, there = Pipe(duplex=False)
            child = os.fork()
            if not child:
                _run(session, files, queue, there)
            there.close()
            connections.append(here)
            children.append(child)
        _show(session, connections, queue)
    finally:  # also after an interruption: a copy that has nobody to report to ends
        _empty(queue)
        for connection in connections:
            connection.close()
        for child in children:
            os.waitpid(child, 0)
        os.close(queue)
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    return True
