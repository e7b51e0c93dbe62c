"""Logs that nobody reads, whose reader has gone, and on a full disk: the server goes on serving, and ends in time."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from streamlod.core.background_log import MAX_LINES, BackgroundHandler
from tests.server.conftest import Clip
from tests.server.ports import held_ports

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pipes of a known size, /dev/full")
_PIPE_BYTES = 4096
_LINES = 300  # far more than the pipe takes


def answer(port: int, path: str) -> bytes:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=60) as response:
        body: bytes = response.read()
        return body


@contextmanager
def serving(clip: Clip, stderr: int) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A server that plays a clip and logs into a descriptor, once it is live."""
    with held_ports(1) as (port,):  # it cannot say which it has: nobody reads its log
        command = [sys.executable, "-m", "streamlod.server.cli", "serve", "--play", str(clip.path), "--port", str(port)]
        process = subprocess.Popen(command, stderr=stderr)
        try:
            limit, state = time.monotonic() + 30, ""
            while state != "live":
                assert time.monotonic() < limit
                time.sleep(0.1)
                try:
                    state = json.loads(answer(port, "/v1/streams/main"))["state"]
                except OSError:
                    continue
            yield process, port
        finally:
            process.kill()
            process.wait()


def goes_on(process: subprocess.Popen[bytes], port: int, replace_worker: bool = False) -> None:
    """Have it log much, and if wanted its worker replaced; it still answers, and ends when told to."""
    for _ in range(_LINES):
        process.send_signal(signal.SIGHUP)  # it logs a line
        time.sleep(0.002)
    before = json.loads(answer(port, "/v1/streams/main"))
    if replace_worker:
        os.kill(_worker(process.pid), signal.SIGKILL)
    limit = time.monotonic() + 60
    while (now := json.loads(answer(port, "/v1/streams/main")))["restarts"] < replace_worker or now == before:
        assert time.monotonic() < limit, now
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0


def _worker(pid: int) -> int:
    """The child that plays the stream."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    raise AssertionError("there is no worker")


@pytest.mark.long
@pytest.mark.parametrize("reader", ["stands still", "has gone"])
def test_a_log_that_nobody_reads_holds_nothing_up(clip: Clip, reader: str) -> None:
    ours, theirs = os.pipe()
    fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    with serving(clip, theirs) as (process, port):
        os.close(theirs)
        if reader == "has gone":
            os.close(ours)
        goes_on(process, port, replace_worker=True)
    if reader == "stands still":
        assert b"listening at" in os.read(ours, 2 * _PIPE_BYTES)
        os.close(ours)


@pytest.mark.long
def test_a_full_log_disk_holds_nothing_up(clip: Clip) -> None:
    with Path("/dev/full").open("wb") as full, serving(clip, full.fileno()) as (process, port):
        goes_on(process, port)


def test_lines_that_nobody_takes_are_left_out_and_counted() -> None:
    ours, theirs = os.pipe()
    fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    handler = BackgroundHandler(theirs)
    for number in range(3 * MAX_LINES):  # goes through although nobody reads until further below
        handler.handle(logging.LogRecord("server", logging.INFO, "", 0, f"line {number}", None, None))
    handler.flush()
    os.set_blocking(ours, False)
    text, limit = b"", time.monotonic() + 20
    while b"were left out" not in text or b"line 999\n" not in text:
        assert time.monotonic() < limit
        try:
            text += os.read(ours, 1 << 16)
        except BlockingIOError:
            time.sleep(0.01)
