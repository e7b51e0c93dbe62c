"""Servers and edges as processes on loopback, from the command line."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import connect

from tests.server.conftest import Viewer

START_SECONDS = 180  # on a machine with much else to do


@dataclass(frozen=True, slots=True)
class Node:
    """A process that listens at `port`, and what it has logged so far."""

    process: subprocess.Popen[bytes]
    port: int
    log: Path

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def get(self, path: str, **headers: str) -> httpx.Response:
        with httpx.Client(base_url=self.url, timeout=60, trust_env=False) as client:
            return client.get(path, headers=headers)

    def stream(self, name: str = "main") -> dict[str, Any]:
        return self.get(f"/v1/streams/{name}").json()  # type: ignore[no-any-return]

    @contextmanager
    def viewing(self, name: str = "main", **options: Any) -> Iterator[Viewer]:
        """A viewer that has not said hello yet."""
        options = {"subprotocols": ["streamlod.v1"], "compression": None, "proxy": None, **options}
        address = f"ws://127.0.0.1:{self.port}/v1/streams/{name}/live"
        with connect(address, max_size=2**24, max_queue=None, **options) as connection:
            yield Viewer(connection)

    def kill(self) -> None:
        """End it with SIGKILL, and the workers, which notice that their server is gone."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


@contextmanager
def node(
    folder: Path, *arguments: object, port: int = 0, source: Path | None = None, **environment: str
) -> Iterator[Node]:
    """`streamlod ARGUMENTS` on `port`, a free one by default; `source` as of `begin`."""
    begun = begin(folder, *arguments, port=port, source=source, **environment)
    try:
        yield listening(begun)
    finally:
        begun[0].kill()
        begun[0].wait()


def begin(
    folder: Path, *arguments: object, port: int = 0, source: Path | None = None, **environment: str
) -> tuple[subprocess.Popen[bytes], Path]:
    """Start a process; it and its log. For `listening`. `source`: run the code of that folder instead of this one."""
    if source is not None:
        environment["PYTHONPATH"] = str(source)
    packaged = source is None or (source / "streamlod").is_dir()  # older code has no package of that name
    module = "streamlod.server.cli" if packaged else "server.cli"
    log = folder / f"{time.monotonic_ns()}.log"
    command = [sys.executable, "-m", module, *map(str, arguments), "--port", str(port)]
    with log.open("wb") as file:
        process = subprocess.Popen(command, stderr=file, stdout=file, cwd=source, env=os.environ | environment)
    return process, log


def listening(begun: tuple[subprocess.Popen[bytes], Path]) -> Node:
    """The process once it listens."""
    process, log = begun
    limit = time.monotonic() + START_SECONDS
    while (found := re.search(rb"listening at \w+://127\.0\.0\.1:(\d+)", log.read_bytes())) is None:
        assert process.poll() is None, log.read_text()
        assert time.monotonic() < limit, log.read_text()
        time.sleep(0.02)
    return Node(process, int(found[1]), log)


def wait_live(server: Node, seconds: float = 60) -> None:
    """Until its stream is live; says what it was instead, and what the server logged."""
    limit = time.monotonic() + seconds
    while (told := server.stream()).get("state") != "live":
        assert time.monotonic() < limit, (told, server.log.read_text()[-3000:])
        time.sleep(0.05)
