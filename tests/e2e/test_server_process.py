"""The server as a user runs it: a process, from the command line."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from streamlod.codec.container import SlodReader
from tests.server.conftest import Clip, Viewer, make_clip
from tests.waiting import wait

PROGRAM = [sys.executable, "-m", "streamlod.server.cli"]


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 60, key_every=20)


@contextmanager
def serving(*arguments: object) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A `streamlod serve` on a free port, with that port."""
    command = [*PROGRAM, "serve", "--port", "0", *map(str, arguments)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if found := re.search(r"https?://127\.0\.0\.1:(\d+)", line):
                yield process, int(found.group(1))
                break
        else:
            pytest.fail("the server did not start")
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


def recorded(folder: Path, clip: Clip, more: str = "") -> list[str]:
    """Arguments for a server that plays and, unlike with `--play`, also records; `more` begins its settings."""
    config = folder.with_name(f"{folder.name}.toml")
    config.write_text(f'{more}\n[[streams]]\nplay = "{clip.path}"\n')
    return ["--state-dir", str(folder), "--config", str(config)]


def ticks(pid: int) -> int:
    """Processor time that a process has taken, also of one that has ended and was not waited for."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return int(fields[11]) + int(fields[12])


def get(port: int, path: str) -> bytes:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=60) as answer:
        body: bytes = answer.read()
        return body


def wait_live(port: int) -> dict[str, Any]:
    limit = time.monotonic() + 60
    while (stream := json.loads(get(port, "/v1/streams/main")))["state"] != "live":
        assert time.monotonic() < limit, stream
        time.sleep(0.05)
    return dict(stream)


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError):  # a thread that ended meanwhile
            children += (task / "children").read_text().split()
    return [pid, *(p for child in set(children) for p in family(int(child)))]


def live(port: int) -> Any:
    address = f"ws://127.0.0.1:{port}/v1/streams/main/live"
    return connect(address, subprotocols=["streamlod.v1"], compression=None, max_size=2**24, max_queue=None, proxy=None)  # type: ignore[list-item]


@pytest.mark.long
def test_playing_needs_little_memory_and_no_training_library(clip: Clip) -> None:
    with serving("--play", clip.path) as (process, port), ExitStack() as stack:
        wait_live(port)
        viewer = Viewer(stack.enter_context(live(port))).hello()
        viewer.until("caught_up")
        total, maps = 0, ""
        for pid in family(process.pid):
            status = Path(f"/proc/{pid}/smaps_rollup").read_text()
            total += int(re.search(r"^Pss:\s+(\d+)", status, re.M).group(1))  # type: ignore[union-attr]
            maps += Path(f"/proc/{pid}/maps").read_text()
        assert "torch" not in maps
        assert total < 300_000


@pytest.mark.long
def test_sigterm_tells_viewers_and_ends_whatever_they_do_with_a_clean_log(clip: Clip) -> None:
    with ExitStack() as stack, serving("--play", clip.path) as (process, port):
        wait_live(port)
        viewer = Viewer(stack.enter_context(live(port))).hello()
        viewer.until("caught_up")
        stack.enter_context(live(port))  # has not said hello
        stuck = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        stuck.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 120)  # takes no answer
        poll = stack.enter_context(closing(HTTPConnection("127.0.0.1", port, timeout=60)))
        poll.request("GET", "/v1/streams/main/manifest?after_epoch=9&wait_ms=9000")
        get(port, "/healthz")  # what came before this has arrived
        process.send_signal(signal.SIGTERM)
        with pytest.raises(ConnectionClosed) as caught:
            viewer.until("nothing that the server sends")
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1001
        told = ticks(process.pid)
        assert json.load(poll.getresponse())["stream"] == "main"
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        # all that is left is to close: what was loaded is not taken apart, which takes two thirds of loading it
        assert ticks(process.pid) - told < 0.4 * told
        assert process.wait(60) == 0
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()


@pytest.mark.long
def test_a_killed_server_keeps_what_it_recorded(clip: Clip, tmp_path: Path) -> None:
    options = recorded(tmp_path / "state", clip)
    with serving(*options) as (process, port):
        wait_live(port)
        wait(lambda: len(json.loads(get(port, "/v1/streams/main/manifest"))["gops"]) >= 2)
        acknowledged = get(port, "/v1/streams/main/bitstream?epoch=1")
        pids = family(process.pid)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    with serving(*options) as (_, port):
        assert wait_live(port)["epoch"] >= 2
        kept = get(port, "/v1/streams/main/bitstream?epoch=1")
        assert kept.startswith(acknowledged[: acknowledged.rindex(b"\xff\xff\xff\xff")])  # all but the index
    path = tmp_path / "kept.slod"
    path.write_bytes(kept)
    with SlodReader(path) as reader:
        assert list(reader.packets()) == clip.packets[: len(reader.entries)]
    limit = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() for pid in pids):  # workers notice that their server is gone
        assert time.monotonic() < limit
        time.sleep(0.1)


@pytest.mark.long
def test_a_bad_start_is_one_sentence_and_exit_code_two() -> None:
    """As tests/server/cli/test_cli.py has of all commands, here in a process of its own."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        command = [*PROGRAM, "serve", "--port", str(taken.getsockname()[1])]
        result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2, result.stderr
    assert "--port" in result.stderr
    assert len(result.stderr.splitlines()) == 1
