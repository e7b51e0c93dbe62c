"""Honest viewers beside peers that misbehave in every way that tests/attack knows, against a real server process.

    python -m tests.bench.abuse_bench [--seconds 60 --viewers 20 --per-second 40]

Prints every few seconds memory, descriptors and processor time of the server, how many were turned away and why, and
in the end what the honest viewers lost: versions that did not come, and connections that were closed. The viewers
decode nothing; the stream is a recorded file. Exit code 1 where a viewer lost something or memory kept growing.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.attack.test_silent_connections import partial, upgrade
from tests.bench.fanout_viewers import masked
from tests.e2e.test_server_process import get, serving, wait_live
from tests.server.conftest import Viewer, make_clip
from tests.server.test_faults import raw

_CLIP_FRAMES, _KEY_EVERY = 400, 100
_HELD = 200  # connections of abusers that are kept open at a time
_GROWTH = 1.25  # of memory, from a third of the time to its end, that counts as flat
_PROTOCOLS: Any = ["streamlod.v1"]
_POST = b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999999\r\n\r\n"
_INGEST = upgrade(path="/v1/streams/main/ingest", protocol="streamlod.push.v1")
_LIMITS = "[limits]\nrequest_seconds = 3\nhello_seconds = 2\nstuck_seconds = 5\n"


class Honest(threading.Thread):
    """A viewer that reads, acknowledges, and counts the versions that it misses."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.address = f"ws://127.0.0.1:{port}/v1/streams/main/live"
        self.packets = self.missed = self.closed = 0
        self.stopping = False

    def run(self) -> None:
        with connect(self.address, subprotocols=_PROTOCOLS, compression=None, max_size=2**24, proxy=None) as peer:
            viewer = Viewer(peer)
            viewer.decoder.push = lambda packet: None  # type: ignore[method-assign,assignment]
            viewer.hello()
            while not self.stopping:
                try:
                    message = viewer.step(10)
                except (ConnectionClosed, TimeoutError):
                    self.closed += not self.stopping
                    return
                if isinstance(message, bytes):
                    self.packets += 1
                elif message["event"] == "skipped":
                    self.missed += 1


def abuse(port: int, chooser: random.Random) -> list[socket.socket]:
    """One act of abuse; the connections that it leaves open."""
    acts: list[Callable[[], list[socket.socket]]] = [
        lambda: [_sent(port, partial(chooser))],
        lambda: [_sent(port, partial(chooser))],
        lambda: [_sent(port, b"GET /v1/streams/main/bitstream HTTP/1.1\r\nHost: localhost\r\n\r\n", 4096)],
        lambda: [_sent(port, _POST + bytes(70_000))],
        lambda: [_sent(port, b"GET /" + b"x" * 70_000)],
        lambda: [raw(port, 4096)],  # a websocket that says nothing
        lambda: [_viewer(port, b'{"type":"hello","versions":[1]}')],  # takes nothing
        lambda: [_viewer(port, b'{"type":"seek","to":{"epoch":' + b"9" * 60 + b"}}")],
        lambda: [_viewer(port, b'{"type":"hello","versions":[1]}', *[masked(1, b'{"type":"pause"}')] * 300)],
        lambda: [_viewer(port, random.Random(chooser.random()).randbytes(100))],
        lambda: [_viewer(port, b"", bytes((0x82, 0xFF)) + (2**62).to_bytes(8, "big") + bytes(4))],
        lambda: [_sent(port, _INGEST + masked(2, bytes(120)))],
        lambda: _come_and_go(port),
    ]
    with contextlib.suppress(OSError, AssertionError):
        return chooser.choice(acts)()
    return []


def _sent(port: int, data: bytes, receive_bytes: int | None = None) -> socket.socket:
    peer = socket.socket()
    if receive_bytes is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    peer.settimeout(5)
    peer.connect(("127.0.0.1", port))
    with contextlib.suppress(OSError):  # refused before the end
        peer.sendall(data)
    return peer


def _viewer(port: int, hello: bytes, *frames: bytes) -> socket.socket:
    peer = raw(port, 4096)
    with contextlib.suppress(OSError):
        peer.sendall(b"".join((masked(1, hello[:125]), *frames)))
    return peer


def _come_and_go(port: int) -> list[socket.socket]:
    for _ in range(5):
        _viewer(port, b'{"type":"hello","versions":[1]}').close()
    return []


def drain(log: Iterable[str] | None) -> None:
    """Read the server's log, which would block it once the pipe is full."""
    with contextlib.suppress(ValueError):  # closed in the end
        for _ in log or ():
            pass


def measure(pid: int) -> tuple[float, int, float]:
    """Resident memory in MB, descriptors, and processor seconds of a process."""
    folder = Path(f"/proc/{pid}")
    resident = int((folder / "statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    return (
        resident,
        len(list((folder / "fd").iterdir())),
        (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"),
    )


def turned_away(port: int) -> str:
    """Counts of refused connections by reason."""
    lines = get(port, "/metrics").decode().splitlines()
    found = [line.split("reason=")[1] for line in lines if line.startswith("streamlod_turned_away_total")]
    return " ".join(line.replace('"} ', "=").replace('"', "").removesuffix(".0") for line in found)


def main() -> None:
    """Run, print, and judge."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--per-second", type=float, default=40.0, help="acts of abuse")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    chooser, held, acts, resident = random.Random(options.seed), list[socket.socket](), itertools.count(), []
    with tempfile.TemporaryDirectory() as name:
        config = Path(name) / "server.toml"
        config.write_text(_LIMITS)
        clip = make_clip(Path(name) / "scene.slod", _CLIP_FRAMES, (20, 80, 300), key_every=_KEY_EVERY)
        with serving("--play", clip.path, "--config", config, "--state-dir", Path(name) / "state") as (process, port):
            threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
            wait_live(port)
            viewers = [Honest(port) for _ in range(options.viewers)]
            for viewer in viewers:
                viewer.start()
            begin = told = time.monotonic()
            while (now := time.monotonic()) < begin + options.seconds:
                held += abuse(port, chooser)
                next(acts)
                while len(held) > _HELD:
                    held.pop(0).close()
                if now > told:
                    told = now + options.seconds / 6
                    memory, descriptors, seconds = measure(process.pid)
                    resident.append(memory)
                    text = f"{memory:.0f} MB, {descriptors} descriptors, {seconds:.1f} CPU s"
                    print(f"{now - begin:6.0f} s: {text}", flush=True)
                time.sleep(max(0.0, 1 / options.per_second - (time.monotonic() - now)))
            for viewer in viewers:
                viewer.stopping = True
            count = next(acts)
            reasons = turned_away(port)
            for peer in held:
                peer.close()
            time.sleep(6)  # every deadline of the settings above
            memory, descriptors, seconds = measure(process.pid)
            alive = json.loads(get(port, "/v1/streams/main"))["state"]
        missed, closed = sum(viewer.missed for viewer in viewers), sum(viewer.closed for viewer in viewers)
        print(f"{count} acts of abuse; turned away: {reasons}")
        print(f"after it: {memory:.0f} MB, {descriptors} descriptors, stream {alive}")
        print(
            f"{len(viewers)} honest viewers: {sum(v.packets for v in viewers)} packets, {missed} skips, {closed} closed"
        )
    flat = resident[-1] < _GROWTH * resident[len(resident) // 3]
    raise SystemExit(0 if flat and not missed and not closed and alive == "live" else 1)


if __name__ == "__main__":
    main()
