"""What is there again after kill -9 of a busy server, at random moments: a table with a line for each kill.

    python -m tests.bench.kill_bench [--kills 20 --seed 1 --longest 3]

The server trains what three cameras film, which `streamlod push` goes on sending ("rig"), plays a file ("played"), runs
a stream that was created over REST ("made") and keeps another one that was created and stopped. A viewer follows each
of the three that run. Columns: seconds that the server had run after all were live; from the start of the next one
until it listens, and until each of the three delivers again, in a new epoch; processor seconds that the server and its
workers had taken by then; seconds until a frame is trained after that; packets that viewers had got and the recordings
were asked for, and what of them they do not hold to the byte. The load is that of the machine, a minute's mean. Exit
code 1 where something was lost, or the stopped stream was not stopped.
"""

from __future__ import annotations

import argparse
import os
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

from streamlod.codec.packet.info import peek
from tests.bench.abuse_bench import drain, filming, write_film
from tests.bench.idle_bench import cpu_seconds
from tests.e2e.test_server_process import family, serving
from tests.server.conftest import Clip, Viewer, make_clip
from tests.server.ports import free_ports

_MAX_SECONDS = 400.0
_CHECKED = 200  # newest packets of a stream that are compared
_RUNNING, _STOPPED = ("rig", "played", "made"), "stopped"
_CONFIG = """roots = ["{folder}"]
[[streams]]
id = "played"
play = "{clip}"
[[streams]]
id = "rig"
live = "{rig}"
"""

Packets = dict[tuple[int, int], bytes]  # by epoch and version


def follow(port: int, name: str, got: Packets) -> None:
    """Watch a stream until the server is killed, and keep what came in order after joining, by its position."""
    address = f"ws://127.0.0.1:{port}/v1/streams/{name}/live"
    options: Any = {"subprotocols": ["streamlod.v1"], "compression": None, "max_size": 2**24, "proxy": None}
    with suppress(ConnectionClosed, OSError, TimeoutError), connect(address, **options) as peer:
        viewer = Viewer(peer)
        viewer.decoder.push = lambda packet: None  # type: ignore[method-assign,assignment,return-value]
        viewer.hello()
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


def until_live(client: httpx.Client, since: dict[str, dict[str, Any]], begin: float) -> dict[str, float]:
    """Wait until all running streams deliver, in a later epoch than before; seconds from `begin` until each did."""
    found: dict[str, float] = {}
    while len(found) < len(_RUNNING):
        now = states(client)
        for name in _RUNNING:
            later = now[name]["epoch"] is not None and now[name]["epoch"] > (since[name]["epoch"] if since else 0)
            if now[name]["state"] == "live" and later:
                found.setdefault(name, time.monotonic() - begin)
        assert time.monotonic() < begin + _MAX_SECONDS, now
        time.sleep(0.05)
    return found


def until_trained(client: httpx.Client, begin: float) -> float:
    """Wait for a frame that was trained, not repeated; seconds from `begin`."""
    while not (report := client.get("/v1/streams/rig").json()["report"]) or report.get("resumed"):
        assert time.monotonic() < begin + _MAX_SECONDS
        time.sleep(0.1)
    return time.monotonic() - begin


def lost(client: httpx.Client, got: dict[str, Packets]) -> list[str]:
    """Packets that viewers got and the recordings do not hold, or not to the byte."""
    found = []
    for name, packets in got.items():
        for (epoch, version), packet in sorted(packets.items())[-_CHECKED:]:
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
    options = parser.parse_args()
    chooser, ran, failures = random.Random(options.seed), 0.0, 0
    slowest = dict.fromkeys(_RUNNING, 0.0)
    with tempfile.TemporaryDirectory() as name, ExitStack() as cameras:
        folder = Path(name)
        clip = make_clip(folder / "scene.slod", 200, (20, 80, 300), key_every=50)
        config = folder / "server.toml"
        config.write_text(_CONFIG.format(clip=clip.path, folder=folder, rig=write_film(folder, cameras=3)))
        (at,) = free_ports(1)  # the same for all, so that the cameras find the next server
        before: dict[str, dict[str, Any]] = {}
        got: dict[str, Packets] = {}
        print("kill  ran s  listens  played    made     rig  cpu s  next frame  packets  lost     load")
        for number in range(options.kills + 1):
            begin = time.monotonic()
            with ExitStack() as stack:
                started = serving("--config", config, "--state-dir", folder / "state", "--port", at)
                process, port = stack.enter_context(started)
                listens = time.monotonic() - begin
                threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
                client = stack.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60))
                if number == 0:
                    _create(client, clip)
                    cameras.enter_context(filming(folder / "film", port))
                live = until_live(client, before, begin)
                spent = sum(cpu_seconds(pid) for pid in family(process.pid))
                trained = until_trained(client, begin)
                if number:
                    missing = lost(client, got)
                    missing += [] if states(client)[_STOPPED]["state"] == "idle" else [_STOPPED]
                    failures += len(missing)
                    slowest = {each: max(slowest[each], live[each]) for each in _RUNNING}
                    count = sum(min(_CHECKED, len(packets)) for packets in got.values())
                    times = f"{live['played']:6.2f} {live['made']:6.2f} {live['rig']:7.2f} {spent:6.2f} {trained:11.2f}"
                    found = ", ".join(missing[:3]) or "nothing"
                    print(
                        f"{number:4d} {ran:6.2f} {listens:8.2f}  {times} {count:8d}  {found} {os.getloadavg()[0]:6.1f}",
                        flush=True,
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
    latest = ", ".join(f"{each} {seconds:.2f} s" for each, seconds in slowest.items())
    print(f"{options.kills} kills; back at the latest after: {latest}; {failures} losses")
    raise SystemExit(1 if failures else 0)


def _create(client: httpx.Client, clip: Clip) -> None:
    for name in ("made", _STOPPED):
        client.post("/v1/streams", json={"id": name, "play": str(clip.path), "start": True}).raise_for_status()
    client.post(f"/v1/streams/{_STOPPED}/stop").raise_for_status()


if __name__ == "__main__":
    main()
