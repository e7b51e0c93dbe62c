"""What is there again after kill -9 of a busy server, at random moments: a table with a line for each kill.

    python -m tests.bench.kill_bench [--kills 20 --seed 1 --synthetic]

The server has a stream of its settings, one that was created over REST and runs, and one that was created and stopped;
with `--synthetic` the first is trained instead of played. A viewer follows each of the first two. Columns: seconds that
the server had run, from the start of the next one until it listens and until both running streams deliver again, and
whether the recordings hold every packet that a viewer had got, to the byte, and the stopped stream is still stopped.
Exit code 1 where something was lost.
"""

from __future__ import annotations

import argparse
import random
import signal
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import httpx
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from codec.packet.info import peek
from tests.bench.abuse_bench import drain
from tests.e2e.test_server_process import serving
from tests.server.conftest import Clip, Viewer, make_clip

_MAX_SECONDS = 120.0
_RUNNING, _STOPPED = ("first", "second"), "third"
_PLAYED = 'roots = ["{1}"]\n[[streams]]\nid = "first"\nplay = "{0}"\n'
_TRAINED = 'roots = ["{1}"]\n[[streams]]\nid = "first"\nsynthetic = {{cameras = 3, width = 96, height = 54}}\n'

Packets = dict[tuple[int, int], bytes]  # by epoch and version


def follow(port: int, name: str, got: Packets) -> None:
    """Watch a stream until the server is killed, and keep what came in order after joining, by its position."""
    address = f"ws://127.0.0.1:{port}/v1/streams/{name}/live"
    options: Any = {"subprotocols": ["streamlod.v1"], "compression": None, "max_size": 2**24, "proxy": None}
    with suppress(ConnectionClosed, OSError, TimeoutError), connect(address, **options) as peer:
        viewer = Viewer(peer).hello()
        epoch = viewer.welcome["epoch"] or 1
        viewer.until("caught_up", _MAX_SECONDS)
        while True:
            message = viewer.step(_MAX_SECONDS)
            if isinstance(message, dict):
                epoch = message["epoch"] if message["event"] == "epoch" else epoch
            elif (info := peek(message)).from_version + 1 == info.to_version:
                got[epoch, info.to_version] = message


def states(client: httpx.Client) -> dict[str, dict[str, Any]]:
    """All streams by id."""
    return {stream["id"]: stream for stream in client.get("/v1/streams").json()["items"]}


def until_live(client: httpx.Client, since: dict[str, dict[str, Any]]) -> None:
    """Wait until both running streams deliver, in a later epoch than before."""
    limit = time.monotonic() + _MAX_SECONDS
    while True:
        now = states(client)
        if all(
            now[name]["state"] == "live" and now[name]["epoch"] > since.get(name, {"epoch": 0})["epoch"]
            for name in _RUNNING
        ):
            return
        assert time.monotonic() < limit, now
        time.sleep(0.02)


def lost(client: httpx.Client, got: dict[str, Packets]) -> list[str]:
    """Packets that viewers got and the recordings do not hold, or not to the byte."""
    found = []
    for name, packets in got.items():
        for (epoch, version), packet in sorted(packets.items())[-200:]:
            answer = client.get(f"/v1/streams/{name}/packets/{epoch}/{version}")
            if answer.status_code != 200 or answer.content != packet:
                found.append(f"{name} {epoch}/{version} ({answer.status_code})")
    return found


def main() -> None:
    """Kill, start again, look, and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=float, default=3.0, help="seconds until a kill, at most")
    parser.add_argument("--synthetic", action="store_true")
    options = parser.parse_args()
    chooser, ran, slowest, failures = random.Random(options.seed), 0.0, 0.0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = make_clip(folder / "scene.slod", 200, (20, 80, 300), key_every=50)
        config = folder / "server.toml"
        config.write_text((_TRAINED if options.synthetic else _PLAYED).format(clip.path, folder))
        before: dict[str, dict[str, Any]] = {}
        got: dict[str, Packets] = {}
        print("kill  ran s  listens s  live s  packets checked  lost")
        for number in range(options.kills + 1):
            begin = time.monotonic()
            with ExitStack() as stack:
                process, port = stack.enter_context(serving("--config", config, "--state-dir", folder / "state"))
                listens = time.monotonic() - begin
                threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
                client = stack.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60))
                if number == 0:
                    _create(client, clip)
                until_live(client, before)
                live = time.monotonic() - begin
                if number:
                    missing = lost(client, got)
                    missing += [] if states(client)[_STOPPED]["state"] == "idle" else [_STOPPED]
                    slowest, failures = max(slowest, live), failures + len(missing)
                    count = sum(map(len, got.values()))
                    print(
                        f"{number:4d}  {ran:5.2f}  {listens:9.2f}  {live:6.2f}  {count:15d}  {missing[:3] or 'nothing'}"
                    )
                got = {each: {} for each in _RUNNING}
                for each in _RUNNING:
                    threading.Thread(target=follow, args=(port, each, got[each]), daemon=True).start()
                ran = chooser.uniform(0.2, options.longest)
                time.sleep(ran)
                before = states(client)
                process.send_signal(signal.SIGKILL)
                process.wait()
                time.sleep(0.2)  # the viewers read what was sent
    print(f"{options.kills} kills: back within {slowest:.2f} s at the latest, {failures} losses")
    raise SystemExit(1 if failures else 0)


def _create(client: httpx.Client, clip: Clip) -> None:
    for name in ("second", _STOPPED):
        client.post("/v1/streams", json={"id": name, "play": str(clip.path), "start": True}).raise_for_status()
    client.post(f"/v1/streams/{_STOPPED}/stop").raise_for_status()


if __name__ == "__main__":
    main()
