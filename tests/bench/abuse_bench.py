"""Honest viewers and cameras beside peers that misbehave in every way that tests/attack knows, against a real server.

    python -m tests.bench.abuse_bench [--seconds 60 --viewers 20 --cameras 4 --per-second 40 --thin 2 --large]

The server plays a recorded file at 10 frames a second and trains what cameras film, which `streamlod push` sends at
two instants a second; half of the viewers watch each, and for some more the server draws. Prints now and then memory
and descriptors of the server, memory of the worker that trains, what the viewers got and lost, and in the end who was
turned away and why. Exit code 1 where a viewer lost a version untold or was closed, a stream is not live, or memory or
descriptors kept growing.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from streamlod.core.camera import Camera
from streamlod.core.synthetic import SyntheticSpec, write_clip
from streamlod.server.ingest.push.message import Codec, PushMessage, pack_push
from tests.attack.test_silent_connections import partial, upgrade
from tests.bench.fanout_viewers import masked
from tests.bench.honest_viewers import Watched, watch
from tests.bench.thin_viewers import ThinWatched
from tests.e2e.test_server_process import PROGRAM, family, get, serving
from tests.server.conftest import make_clip
from tests.server.large_clip import COUNTS
from tests.server.test_faults import raw

_CLIP_FRAMES, _KEY_EVERY, _FRAME_NS = 400, 100, 100_000_000
_LARGE_FRAMES, _LARGE_KEY_EVERY = 120, 30
_CAMERA_FPS = 2.0
_START_SECONDS = 300.0
_HELD = 200  # connections of abusers that are kept open at a time
_GROWTH = 1.25  # of memory, from the second third of the time to the last, that counts as flat
_POST = b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999999\r\n\r\n"
_INGEST = upgrade(path="/v1/streams/rig/ingest", protocol="streamlod.push.v1")
_SETTINGS = """
[limits]
request_seconds = 3
hello_seconds = 2
stuck_seconds = 5
viewers_per_address = 400
[worker]
spare = false
[[streams]]
id = "main"
play = "{clip}"
"""
_RIG = """
[[streams]]
id = "rig"
live = "{rig}"
"""


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
        lambda: [_sent(port, _INGEST + masked(2, _garbage(chooser)))],
        lambda: [_sent(port, _INGEST + masked(2, _garbage(chooser)) * 50)],
        lambda: _come_and_go(port),
    ]
    with contextlib.suppress(OSError, AssertionError):
        return chooser.choice(acts)()
    return []


def _garbage(chooser: random.Random) -> bytes:
    """A pushed picture in the right form that is none, in a frame of less than 126 bytes."""
    codec = chooser.choice(list(Codec))
    return pack_push(PushMessage("cam00", chooser.randrange(2**40), None, codec, chooser.randbytes(40)))[:125]


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


@contextlib.contextmanager
def filming(folder: Path, port: int) -> Iterator[None]:
    """A capture node that sends what the cameras of `write_film` film until the context ends."""
    url = f"ws://127.0.0.1:{port}/v1/streams/rig/ingest"
    command = [*PROGRAM, "push", url, str(folder), "--loop"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as node:
        try:
            yield
        finally:
            node.terminate()


def write_film(folder: Path, cameras: int) -> Path:
    """What so many cameras film, in the folder "film" of `folder`, and the rig file of these cameras."""
    write_clip(SyntheticSpec(cameras=cameras, frames=30, width=96, height=54, fps=_CAMERA_FPS), folder / "film")
    names = [f"cam{number:02d}" for number in range(cameras)]
    rig: dict[str, Any] = {"fps": _CAMERA_FPS, "policy": {"quorum": cameras - 1}, "calibration": str(folder / "film")}
    rig["cameras"] = [{"name": name, "source": "push:"} for name in names]
    path = folder / "rig.json"
    path.write_text(json.dumps(rig))
    return path


def write_settings(folder: Path, cameras: int, large: bool) -> tuple[Path, Camera]:
    """The settings file of the server, with what its streams are made from beside it, and a camera of the clip."""
    frames, counts, key_every = _CLIP_FRAMES, (20, 80, 300), _KEY_EVERY
    if large:
        frames, counts, key_every = _LARGE_FRAMES, COUNTS, _LARGE_KEY_EVERY
    clip = make_clip(folder / "scene.slod", frames, counts, key_every=key_every, frame_ns=_FRAME_NS)
    print(f"keyframes of {min(len(packet) for packet in clip.packets[::key_every])} bytes and more", flush=True)
    path = folder / "server.toml"
    rig = _RIG.format(rig=write_film(folder, cameras)) if cameras else ""
    path.write_text(_SETTINGS.format(clip=clip.path) + rig)
    return path, clip.states[0].header.cameras[0].scaled(160, 90)


def until_live(port: int, name: str) -> None:
    """Wait until a stream is live."""
    limit = time.monotonic() + _START_SECONDS
    while (stream := json.loads(get(port, f"/v1/streams/{name}")))["state"] != "live":
        assert time.monotonic() < limit, stream
        time.sleep(0.5)


def is_flat(figures: list[float], allowed: float) -> bool:
    """Whether the last third is not above the middle one by more than a factor."""
    third = max(1, len(figures) // 3)
    return max(figures[-third:]) <= allowed * max(figures[third : 2 * third] or figures)


def main() -> None:  # noqa: PLR0915  a script
    """Run, print, and judge."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--viewers", type=int, default=20)
    parser.add_argument("--cameras", type=int, default=4, help="of the stream that trains; 0 for none")
    parser.add_argument("--per-second", type=float, default=40.0, help="acts of abuse")
    parser.add_argument("--thin", type=int, default=2, help="viewers for which the server draws")
    parser.add_argument("--large", action="store_true", help="keyframes of 300 KB and more, every three seconds")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    names = ("main", "rig") if options.cameras else ("main",)
    chooser, held, acts = random.Random(options.seed), list[socket.socket](), 0
    resident, training, descriptors = list[float](), list[float](), list[float]()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        config, camera = write_settings(folder, options.cameras, options.large)
        process, port = stack.enter_context(serving("--config", config, "--state-dir", folder / "state"))
        threading.Thread(target=drain, args=(process.stderr,), daemon=True).start()
        if options.cameras:
            stack.enter_context(filming(folder / "film", port))
        for name in names:
            until_live(port, name)
        before = {name: json.loads(get(port, f"/v1/streams/{name}"))["restarts"] for name in names}
        pipe, theirs = get_context("spawn").Pipe()
        arguments = (theirs, port, options.viewers, names)
        get_context("spawn").Process(target=watch, args=arguments, daemon=True).start()
        theirs.close()
        pipe.recv()
        thin = ThinWatched()
        thin.begin(port, options.thin, camera, stack)
        begin = told = time.monotonic()
        while (now := time.monotonic()) < begin + options.seconds:
            held += abuse(port, chooser)
            acts += 1
            while len(held) > _HELD:
                held.pop(0).close()
            if now >= told:
                told = now + options.seconds / 12
                memory, count, _ = measure(process.pid)
                worker = max(measure(pid)[0] for pid in family(process.pid)[1:])
                resident.append(memory)
                descriptors.append(count)
                training.append(worker)
                pipe.send("collect")
                got: dict[str, Watched] = pipe.recv()
                seen = "; ".join(
                    f"{name}: {w.packets} packets, {w.skips} skips, {w.missed} missed, {len(w.closed)} closed"
                    for name, w in got.items()
                )
                text = f"{memory:.0f} MB, worker {worker:.0f} MB, {count} descriptors; {seen}; {thin.pictures} pictures"
                print(f"{now - begin:6.0f} s, {acts} acts: {text}; load {os.getloadavg()[0]:.0f}", flush=True)
            time.sleep(max(0.0, 1 / options.per_second - (time.monotonic() - now)))
        pipe.send("collect")
        got = pipe.recv()
        reasons = turned_away(port)
        for peer in held:
            peer.close()
        time.sleep(6)  # every deadline of the settings above
        memory, count, _ = measure(process.pid)
        streams = {name: json.loads(get(port, f"/v1/streams/{name}")) for name in names}
        pipe.send(None)
    print(f"{acts} acts of abuse; turned away: {reasons}")
    print(f"after it: {memory:.0f} MB, {count} descriptors")
    for name, watched in got.items():
        stream = streams[name]
        restarts = stream["restarts"] - before[name]
        print(
            f"{name}: {stream['state']}, {restarts} restarts; {watched.packets} packets to honest viewers, "
            f"{watched.skips} skips told, {watched.missed} missed, closed: {', '.join(watched.closed) or 'none'}"
        )
    print(f"{thin.pictures} pictures to {options.thin} thin viewers, closed: {', '.join(thin.closed) or 'none'}")
    good = not thin.closed and all(stream["state"] == "live" for stream in streams.values())
    good = good and not any(watched.missed or watched.closed for watched in got.values())
    flat = is_flat(resident, _GROWTH) and is_flat(training, _GROWTH) and is_flat(descriptors, 2 * _GROWTH)
    raise SystemExit(0 if good and flat else 1)


if __name__ == "__main__":
    main()
