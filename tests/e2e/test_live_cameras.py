"""Cameras to viewers with real processes: fake cameras send by RTSP or push, a server trains, viewers watch."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.container import SlodReader
from streamlod.core.arrays import UInt8
from streamlod.core.metrics import psnr
from streamlod.core.synthetic import SyntheticSpec, write_clip
from tests.e2e.test_server_process import PROGRAM, family, get, live, serving
from tests.server.conftest import Viewer
from tests.server.ingest.rig import NEEDS_FFMPEG, rtsp, sending
from tests.server.ports import free_ports

_LOG = logging.getLogger(__name__)
CAMERAS = ("cam00", "cam01", "cam02", "cam03")
FPS = 30
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600), NEEDS_FFMPEG]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated clip, with a transport stream beside each video that a fake camera can play for two minutes."""
    folder = tmp_path_factory.mktemp("film") / "clip"
    write_clip(SyntheticSpec(cameras=4, frames=FPS, width=160, height=90), folder)
    for name in CAMERAS:
        command = ["ffmpeg", "-nostdin", "-loglevel", "error", "-stream_loop", "119", "-i", str(folder / f"{name}.mp4")]
        encode = ["-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency", "-g", "15", "-crf", "20"]
        subprocess.run([*command, *encode, "-f", "mpegts", str(folder.parent / f"{name}.ts")], check=True)
    return folder


def write_rig(folder: Path, film: Path, sources: list[str]) -> Path:
    cameras = [{"name": name, "source": source} for name, source in zip(CAMERAS, sources, strict=True)]
    path = folder / "rig.json"
    path.write_text(json.dumps({"fps": FPS, "policy": {"quorum": 3}, "calibration": str(film), "cameras": cameras}))
    return path


def wait(port: int, done: Callable[[dict[str, Any]], bool], seconds: float = 60) -> dict[str, Any]:
    """The stream, as soon as it is so."""
    limit = time.monotonic() + seconds
    while not done(stream := json.loads(get(port, "/v1/streams/main"))):
        assert time.monotonic() < limit, stream
        assert stream["state"] != "failed", stream
        time.sleep(0.05)
    return dict(stream)


def is_live(stream: dict[str, Any]) -> bool:
    return bool(stream["state"] == "live")


def test_rtsp_cameras_are_trained_through_their_faults_and_the_workers_death(film: Path, tmp_path: Path) -> None:
    ports = free_ports(4)
    rig = write_rig(tmp_path, film, [f"rtsp+listen://127.0.0.1:{port}/live" for port in ports])
    clips = [film.parent / f"{name}.ts" for name in CAMERAS]
    with (
        ThreadPoolExecutor(1) as pool,
        serving("--live", rig, "--state-dir", tmp_path / "state") as (server, port),
        live(port) as connection,
        sending(clips[0], rtsp(ports[0]), again=True),
        sending(clips[1], rtsp(ports[1]), again=True) as (stalling,),
        sending(clips[2], rtsp(ports[2]), again=True) as (dying,),
        sending(clips[3], rtsp(ports[3]), before={0: ("-itsoffset", "0.05")}, again=True),
    ):
        viewer = Viewer(connection).hello()
        watching = pool.submit(watch, viewer)
        filmed = wait(port, is_live, 300)
        cameras = filmed["ingest"]["cameras"]
        assert {camera["clock_source"] for camera in cameras.values()} == {"ntp"}
        assert filmed["ingest"]["dropped_stale"] > 0  # training this is slower than filming

        stalling.pause()
        found = wait(port, lambda stream: stream["state"] == "degraded")
        assert found["detail"].startswith("camera cam01 is lost")
        time.sleep(2)
        stalling.resume()
        found = wait(port, is_live)
        assert found["ingest"]["cameras"]["cam01"]["connections"] == 1
        assert found["ingest"]["cameras"]["cam01"]["counts"]["missing"] > FPS

        dying.kill()
        assert "cam02" in wait(port, lambda stream: stream["state"] == "degraded")["detail"]
        with sending(clips[2], rtsp(ports[2]), again=True):
            found = wait(port, is_live)
            assert found["ingest"]["cameras"]["cam02"]["connections"] == 2
            assert (
                'streamlod_camera_connections_total{camera="cam02",stream="main"} 2.0' in get(port, "/metrics").decode()
            )

            begin = time.monotonic()
            os.kill(worker_of(server), signal.SIGKILL)
            found = wait(port, lambda stream: stream["epoch"] == 2, 30)
            _LOG.info("from the kill to a picture of the new epoch: %.2f s", time.monotonic() - begin)
            assert found["restarts"] == 1
            trained = wait(port, lambda stream: is_live(stream) and stream["version"] > found["version"] + 2, 120)
            assert trained["report"]["latency_seconds"] > 0
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0
        assert watching.result(60) == 1001  # and every packet on the way there was decoded
        states = [event["state"] for event in viewer.named("state")]
        assert states.count("degraded") >= 3
    segments = sorted((tmp_path / "state" / "streams" / "main").glob("*.slod"))
    assert {segment.name[:6] for segment in segments} == {"000001", "000002"}
    packets = 0
    for segment in segments:
        with SlodReader(segment) as reader:
            packets += len(list(reader.packets()))  # checksums hold
    assert packets > 4


def watch(viewer: Viewer) -> int | None:
    """Decode everything until the server hangs up; the close code."""
    try:
        while True:
            viewer.step(300)
    except ConnectionClosed as closed:
        return None if closed.rcvd is None else closed.rcvd.code


def worker_of(server: subprocess.Popen[str]) -> int:
    """The process that trains: the largest of the server's."""
    return max(family(server.pid)[1:], key=lambda pid: int(Path(f"/proc/{pid}/statm").read_text().split()[1]))


def test_a_capture_node_pushes_and_a_viewer_sees_the_scene(film: Path, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, film, ["push:"] * 4)
    videos = [f"{name}={film / name}.mp4" for name in CAMERAS]
    with serving("--live", rig) as (_, port):
        address = f"ws://127.0.0.1:{port}/v1/streams/main/"
        node = subprocess.Popen([*PROGRAM, "push", address + "ingest", *videos, "--loop"], stderr=subprocess.DEVNULL)
        try:
            found = wait(port, is_live, 300)
            assert {camera["clock_source"] for camera in found["ingest"]["cameras"].values()} == {"stated"}
            view = [
                *PROGRAM,
                "view",
                address + "live",
                "--camera",
                "cam01",
                "--frames",
                "2",
                "--out",
                str(tmp_path / "seen"),
            ]
            subprocess.run(view, check=True, timeout=60, stderr=subprocess.DEVNULL)
        finally:
            node.kill()
            node.wait()
        found = wait(port, lambda stream: stream["state"] == "degraded")
        assert "its phone or capture node has disconnected" in found["detail"]
    pictures = sorted((tmp_path / "seen").glob("*.png"))
    assert len(pictures) == 2
    (seen,) = decoded(pictures[-1])
    assert max(psnr(truth, seen) for truth in decoded(film / "cam01.mp4")) > 20


def decoded(path: Path) -> list[UInt8]:
    """Pictures of a file, [H,W,3] RGB each."""
    with av.open(str(path)) as container:
        return [np.asarray(frame.to_ndarray(format="rgb24"), np.uint8) for frame in container.decode(video=0)]
