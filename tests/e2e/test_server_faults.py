"""A real server process with a full disk, a clock that is set, and peers that mean harm: it stays up and counts."""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.container import SlodReader
from tests.e2e.test_server_process import PROGRAM, get, live, recorded, wait_live
from tests.server.conftest import Clip, Viewer, make_clip
from tests.server.test_faults import masked, raw
from tests.waiting import wait

_LOG = logging.getLogger(__name__)
_CLOCK = """
import signal, sys, time
shift = 0
real_time, real_time_ns = time.time, time.time_ns
time.time = lambda: real_time() + shift
time.time_ns = lambda: real_time_ns() + shift * 10**9
def step(number, frame):
    global shift
    shift += 3600 if number == signal.SIGUSR1 else -7200
signal.signal(signal.SIGUSR1, step)
signal.signal(signal.SIGUSR2, step)
from streamlod.server.cli.main import main
main()
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 60, key_every=10)


@contextmanager
def started(command: list[str]) -> Iterator[tuple[subprocess.Popen[str], int, list[str]]]:
    """A server by its whole command line; its port, and its log so far."""
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    log: list[str] = []
    reading = threading.Thread()
    try:
        for line in process.stderr:
            log.append(line)
            if found := re.search(r"http://127\.0\.0\.1:(\d+)", line):
                break
        else:
            pytest.fail("".join(log))
        reading = threading.Thread(target=log.extend, args=(process.stderr,))  # a full pipe would halt the server
        reading.start()
        yield process, int(found.group(1)), log
    finally:
        process.kill()
        process.wait()
        if reading.ident is not None:
            reading.join()
        process.stderr.close()


def metrics(port: int) -> dict[str, float]:
    """All samples, by name and labels."""
    lines = get(port, "/metrics").decode().splitlines()
    return {name: float(value) for name, value in (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))}


def away(port: int, reason: str) -> float:
    return metrics(port).get(f'streamlod_turned_away_total{{reason="{reason}"}}', 0.0)


def stream(port: int) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(get(port, "/v1/streams/main"))
    return found


def follows(port: int) -> None:
    """A viewer can join, and gets packets."""
    with live(port) as connection:
        viewer = Viewer(connection).hello()
        viewer.until("caught_up")
        viewer.next_packet()


@pytest.mark.long
def test_a_full_disk_stops_recording_and_nothing_else(clip: Clip, tmp_path: Path) -> None:
    unshare = shutil.which("unshare")
    mount = ["unshare", "--user", "--map-root-user", "--mount"]
    probe = [*mount, "mount", "-t", "tmpfs", "none", "/mnt"]
    if unshare is None or subprocess.run(probe, capture_output=True, check=False).returncode:
        pytest.skip("small disks cannot be mounted here")
    size = sum(map(len, clip.packets))
    options = recorded(tmp_path, clip, "[retention]\nreserve_fraction = 0.0")
    script = f'mount -t tmpfs -o size={size // 2} none {tmp_path} && exec "$@"'  # room for half of the clip
    serve = [*PROGRAM, "serve", "--port", "0", *options]
    with started([*mount, "sh", "-c", script, "sh", *serve]) as (process, port, _):
        wait_live(port)
        wait(lambda: "stopped" in stream(port)["recording"])
        lost = metrics(port)['streamlod_recording_lost_packets_total{stream="main"}']
        assert lost > 0
        follows(port)
        assert stream(port)["state"] == "live"
        kept = tmp_path.with_name("kept.slod")
        kept.write_bytes(get(port, "/v1/streams/main/bitstream?epoch=1"))
        with SlodReader(kept) as reader:
            packets = list(reader.packets())
            assert packets == clip.packets[: len(packets)]
        assert len(packets) > 10
        for segment in Path(f"/proc/{process.pid}/root{tmp_path}/streams/main").glob("*.slod"):
            segment.unlink()  # somebody makes room
        wait(lambda: stream(port)["recording"] == "on")
        process.send_signal(signal.SIGTERM)
        process.wait(60)


@pytest.mark.long
def test_a_clock_that_is_set_deletes_nothing_and_stops_nobody(clip: Clip, tmp_path: Path) -> None:
    options = recorded(tmp_path / "state", clip, "[retention]\nseconds = 1800")
    command = [sys.executable, "-c", _CLOCK, "serve", "--port", "0", *options]
    with started(command) as (process, port, _), ExitStack() as stack:
        wait_live(port)
        viewer = Viewer(stack.enter_context(live(port))).hello()
        viewer.until("caught_up")
        for number in (signal.SIGUSR1, signal.SIGUSR2):
            process.send_signal(number)
            for _ in range(25):  # two keyframes and more
                viewer.next_packet()
        manifest = json.loads(get(port, "/v1/streams/main/manifest"))
        assert (manifest["gops"][0]["epoch"], manifest["gops"][0]["first"]) == (1, 0)
        times = [gop["begun_ns"] for gop in manifest["gops"] if gop["begun_ns"]]
        steps = [later - earlier for earlier, later in itertools.pairwise(times)]
        assert max(steps) > 3500e9  # the clock was set indeed
        assert min(steps) < -7000e9
        assert stream(port)["restarts"] == 0
        assert not viewer.named("skipped")


@pytest.mark.long
def test_a_thousand_silent_viewers_are_shown_out(clip: Clip, tmp_path: Path) -> None:
    config = tmp_path / "server.toml"
    config.write_text("[limits]\nhello_seconds = 2.0\nconnections = 3000\n")
    few_files = ["sh", "-c", 'ulimit -Sn 512; exec "$@"', "sh"]  # which the server has to raise
    command = [*few_files, *PROGRAM, "serve", "--port", "0", "--play", str(clip.path), "--config", str(config)]
    with started(command) as (process, port, _), ExitStack() as stack:
        wait_live(port)
        follows(port)
        files = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
        for _ in range(1000):
            stack.enter_context(raw(port))
        follows(port)
        wait(lambda: away(port, "4408") == 1000)
        stack.close()
        wait(lambda: len(list(Path(f"/proc/{process.pid}/fd").iterdir())) <= files + 3)


def answer(peer: socket.socket) -> bytes:
    """Everything until the server closes."""
    found = b""
    with contextlib.suppress(ConnectionError):
        while more := peer.recv(4096):
            found += more
    return found


@pytest.mark.long
def test_hostile_viewers_are_refused_and_counted(clip: Clip) -> None:
    command = [*PROGRAM, "serve", "--port", "0", "--play", str(clip.path)]
    with started(command) as (_, port, _), ExitStack() as stack:
        wait_live(port)
        for _ in range(3):  # frames that claim to be giants
            peer = stack.enter_context(raw(port))
            peer.sendall(b"\x81\xff" + (2**63 - 1).to_bytes(8, "big") + bytes(4))
            assert b"\x03\xf1" in answer(peer)
        assert away(port, "1009") == 3
        for _ in range(3):  # floods
            with live(port) as connection:
                viewer = Viewer(connection).hello()
                with contextlib.suppress(ConnectionClosed):
                    for _ in range(300):
                        viewer.send(type="pause")
                with pytest.raises(ConnectionClosed) as caught:
                    viewer.until("nothing that the server sends")
                assert caught.value.rcvd is not None
                assert caught.value.rcvd.code == 4429
        assert away(port, "4429") == 3
        peer = stack.enter_context(raw(port))
        peer.sendall(masked(1, b'{"type":"hello","versions":[1]}') + masked(9, b"x") * 2000)  # pings
        peer.close()
        follows(port)
        assert stream(port)["restarts"] == 0


@pytest.mark.long
def test_hostile_requests_are_refused_and_counted(clip: Clip, tmp_path: Path) -> None:
    config = tmp_path / "server.toml"
    config.write_text("[limits]\nrequest_seconds = 2.0\nconnections = 40\n")
    command = [*PROGRAM, "serve", "--port", "0", "--play", str(clip.path), "--config", str(config)]
    with started(command) as (_, port, _), ExitStack() as stack:
        wait_live(port)

        def connect() -> socket.socket:
            return stack.enter_context(socket.create_connection(("127.0.0.1", port), 20))

        slow, body, silent = connect(), connect(), connect()
        slow.sendall(b"GET /v1/streams HTTP/1.1\r\n")
        body.sendall(b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{")
        for _ in range(3):
            time.sleep(0.25)
            slow.sendall(b"X-A: b\r\n")
        for peer in (slow, body, silent):
            assert b"408" in answer(peer).split(b"\r\n")[0]
        assert away(port, "slow") == 3
        huge, chunked = connect(), connect()  # a head and a body without end
        huge.sendall(b"GET / HTTP/1.1\r\n")
        with contextlib.suppress(ConnectionError):
            for _ in range(100):
                huge.sendall(b"X: " + b"a" * 8000 + b"\r\n")
        chunked.sendall(b"POST /v1/streams HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n")
        with contextlib.suppress(ConnectionError):
            for _ in range(100):
                chunked.sendall(b"1000\r\n" + b"a" * 4096 + b"\r\n")
        wait(lambda: away(port, "large") + away(port, "slow") == 5)
        assert away(port, "large") >= 1  # a busy machine may take too long for the other
        crowd = [connect() for _ in range(90)]  # more than twice as many as there may be
        for peer in crowd:
            answer(peer)  # cut off at once, or for its silence
        wait(lambda: away(port, "many") > 0)
        follows(port)
        assert stream(port)["restarts"] == 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_memory_and_descriptors_stay_flat_while_viewers_come_and_go(clip: Clip, tmp_path: Path) -> None:
    minutes = float(os.environ.get("STREAMLOD_SOAK_MINUTES", "20"))
    options = recorded(tmp_path / "state", clip, "[retention]\nmemory_bytes = 1000000\nbytes = 2000000")
    command = [*PROGRAM, "serve", "--port", "0", *options]
    samples: list[tuple[int, int]] = []
    with started(command) as (process, port, _):
        wait_live(port)
        end, number = time.monotonic() + 60 * minutes, 0
        while time.monotonic() < end:
            _churn(port, number)
            time.sleep(0.5)
            number += 1
            if number % 10 == 0:
                files = len(list(Path(f"/proc/{process.pid}/fd").iterdir()))
                status = Path(f"/proc/{process.pid}/status").read_text()
                samples.append((int(re.search(r"VmRSS:\s+(\d+)", status).group(1)), files))  # type: ignore[union-attr]
                _LOG.info("after %d rounds of viewers: %d kB, %d descriptors", number, *samples[-1])
        assert stream(port)["restarts"] == 0
    settled, late = samples[len(samples) // 4 : len(samples) // 2], samples[-len(samples) // 4 :]
    memory = [sorted(kilobytes for kilobytes, _ in part)[len(part) // 2] for part in (settled, late)]
    assert memory[1] - memory[0] < 400 * minutes, samples  # kB: 0.4 MB a minute
    assert max(files for _, files in late) <= max(files for _, files in settled) + 2, samples


def _churn(port: int, number: int) -> None:
    """Eight viewers: some leave properly, some are cut off, one never says hello, one seeks."""
    with ExitStack() as stack:
        viewers = [Viewer(stack.enter_context(live(port))) for _ in range(6)]
        for viewer in viewers[1:]:
            viewer.hello(levels=1 + number % 3)
        viewers[1].send(type="seek", to={"epoch": number % 5, "version": number % 60})
        for viewer in viewers[2:]:
            viewer.until("caught_up")
            for _ in range(5):
                viewer.next_packet()
        for peer in (raw(port), raw(port, 4096)):
            peer.sendall(masked(1, b'{"type":"hello","versions":[1]}'))
            peer.close()
        viewers[3].connection.socket.shutdown(socket.SHUT_RDWR)
        get(port, "/v1/streams/main/bitstream")
