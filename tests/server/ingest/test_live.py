"""Fake cameras over real protocols on loopback: every instant holds pictures of one time, whatever goes wrong."""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.frames import FrameSet
from streamlod.server.ingest.live import LiveDataset, open_live
from streamlod.server.ingest.statistics import Statistics
from streamlod.server.ingest.sync.camera_track import CameraState
from streamlod.server.ingest.sync.clock import ClockSource
from tests.server.ingest.rig import (
    FPS,
    NEEDS_FFMPEG,
    number_of,
    rtsp,
    sending,
    write_clip,
    write_definition,
)
from tests.server.ports import free_ports

PERIOD_NS = 1_000_000_000 / FPS


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clips") / "clip.ts"
    write_clip(path, 100)
    return path


@dataclass
class Seen:
    """One instant: its place on the grid in periods, the number each camera's picture carries (-1: missing)."""

    instant: int
    time_ns: int
    numbers: list[int]


class Watch:
    """Collects instants on a thread, as training would."""

    def __init__(self, dataset: LiveDataset, slowness: float = 0) -> None:
        self.dataset, self.seen, self.statistics = dataset, list[Seen](), list[Statistics]()
        self._frames = dataset.frames()
        self._slowness = slowness
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._stop = threading.Event()
        self._thread.start()

    def _run(self) -> None:
        first = None
        for frame in self._frames:
            first = frame.time_ns if first is None else first
            numbers = [
                number_of(image) if there else -1 for image, there in zip(frame.images, frame.present, strict=True)
            ]
            self.seen.append(Seen(round((frame.time_ns - first) / PERIOD_NS), frame.time_ns, numbers))
            if self._stop.wait(self._slowness) or self._stop.is_set():
                break
        self._frames.close()  # type: ignore[attr-defined]

    def wait(self, condition: Callable[[], bool], seconds: float = 40) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"not within {seconds} s: {self.dataset.statistics()}"
            time.sleep(0.02)

    def now(self) -> Statistics:
        statistics = self.dataset.statistics()
        assert statistics is not None
        return statistics

    def close(self) -> None:
        self._stop.set()
        self.dataset.close()
        self._thread.join(60)
        assert not self._thread.is_alive()


@pytest.fixture
def watch() -> Iterator[Callable[..., Watch]]:
    watches: list[Watch] = []

    def begin(path: Path, **options: float) -> Watch:
        watches.append(Watch(open_live(path), **options))
        return watches[-1]

    yield begin
    for each in watches:
        each.close()


def misaligned(seen: list[Seen], cameras: int) -> int:
    """Instants in which a camera's picture isn't the one of that time.

    Fake cameras count from their own start in real time, so that number minus instant is one constant a camera.
    """
    count = 0
    constants = []
    for row in range(cameras):
        differences = [entry.numbers[row] - entry.instant for entry in seen if entry.numbers[row] >= 0]
        constants.append(int(np.median(differences)))
    for entry in seen:
        count += any(n >= 0 and n - entry.instant != constants[row] for row, n in enumerate(entry.numbers))
    return count


def complete(watch: Watch) -> int:
    return sum(-1 not in entry.numbers for entry in list(watch.seen))


@pytest.mark.long
@NEEDS_FFMPEG
def test_rtsp_cameras_are_paired_through_a_stop_and_a_death(
    tmp_path: Path, clip: Path, watch: Callable[..., Watch]
) -> None:
    _film(tmp_path, clip, watch, quiet=60, pause=2.0)


@NEEDS_FFMPEG
@pytest.mark.slow
@pytest.mark.timeout(180)
def test_rtsp_cameras_for_a_minute(tmp_path: Path, clip: Path, watch: Callable[..., Watch]) -> None:
    _film(tmp_path, clip, watch, quiet=60 * FPS, pause=3.0)


def _film(tmp_path: Path, clip: Path, watch: Callable[..., Watch], quiet: int, pause: float) -> None:
    ports = free_ports(4)
    rig = watch(write_definition(tmp_path, [f"rtsp+listen://127.0.0.1:{p}/live" for p in ports], {"quorum": 3}))
    time.sleep(0.5)
    skew = {3: ("-itsoffset", "0.05")}
    with sending(clip, *(rtsp(port) for port in ports), before=skew, again=True) as senders:
        rig.wait(lambda: complete(rig) >= quiet and not rig.now().degraded, 60 + quiet / FPS)
        before = rig.now()
        assert {camera.clock_source for camera in before.cameras.values()} == {ClockSource.NTP}

        senders[1].pause()
        rig.wait(lambda: rig.now().degraded)
        assert rig.now().cameras["cam1"].state is CameraState.LOST
        time.sleep(pause - 1)
        during = len(rig.seen)
        assert rig.seen[-1].numbers[1] == -1
        senders[1].resume()
        rig.wait(lambda: all(-1 not in entry.numbers for entry in rig.seen[-10:]) and len(rig.seen) > during + 20)
        after = rig.now()
        assert not after.degraded
        assert after.cameras["cam1"].counts.missing - before.cameras["cam1"].counts.missing >= (pause - 0.5) * FPS
        assert after.cameras["cam1"].counts.late >= FPS / 2
        assert after.cameras["cam1"].connections == 1
        assert misaligned(rig.seen, 4) == 0

        senders[2].kill()
        rig.wait(lambda: rig.now().degraded)
        died = len(rig.seen)
        rig.wait(lambda: len(rig.seen) > died + 5)
        assert rig.seen[-1].numbers[2] == -1
        with sending(clip, rtsp(ports[2])):
            rig.wait(lambda: all(-1 not in entry.numbers for entry in rig.seen[-10:]))
            assert not rig.now().degraded
            assert rig.now().cameras["cam2"].connections == 2
            assert misaligned(rig.seen[-10:], 4) == 0


@pytest.mark.long
@NEEDS_FFMPEG
def test_transport_streams_and_rtmp_are_paired_by_arrival(
    tmp_path: Path, clip: Path, watch: Callable[..., Watch]
) -> None:
    udp, tcp, http, rtmp = free_ports(4)
    sources = [
        f"udp://127.0.0.1:{udp}",
        f"tcp+listen://127.0.0.1:{tcp}",
        f"http://127.0.0.1:{http}/live.ts",
        f"rtmp+listen://127.0.0.1:{rtmp}/live/cam",
    ]
    rig = watch(write_definition(tmp_path, sources, {"quorum": 2}))
    time.sleep(0.3)
    outputs = [
        ("-f", "mpegts", "-listen", "1", f"http://127.0.0.1:{http}/live.ts"),
        ("-f", "mpegts", f"tcp://127.0.0.1:{tcp}"),
        ("-f", "flv", f"rtmp://127.0.0.1:{rtmp}/live/cam"),
        ("-f", "mpegts", f"udp://127.0.0.1:{udp}?pkt_size=1316"),
    ]
    one_process = [argument for output in outputs for argument in ("-map", "0", "-c", "copy", *output)]
    with sending(clip, tuple(one_process), again=True):
        rig.wait(lambda: complete(rig) >= 60)
        for entry in rig.seen:  # all copies of a picture leave at one time
            assert len({number for number in entry.numbers[:3] if number >= 0}) <= 1
            if -1 not in entry.numbers:  # transport streams are read with up to three pictures of delay, RTMP without
                assert 0 <= entry.numbers[3] - entry.numbers[0] <= 3
        assert misaligned(rig.seen, 4) == 0
        assert {camera.clock_source for camera in rig.now().cameras.values()} == {ClockSource.ARRIVAL}


def test_unpaced_files_deliver_every_instant_exactly(tmp_path: Path) -> None:
    for row in range(3):
        write_clip(tmp_path / f"{row}.ts", 1)
    path = write_definition(tmp_path, ["0.ts", "1.ts", "2.ts"], realtime=False)
    frames = list(open_live(path).frames())
    assert [frame.index for frame in frames] == list(range(FPS))
    assert [[number_of(image) for image in frame.images] for frame in frames] == [[k] * 3 for k in range(FPS)]
    steps = np.diff([frame.time_ns for frame in frames])
    assert np.abs(steps - PERIOD_NS).max() <= 1


def test_a_slow_consumer_gets_the_newest_and_drops_are_counted(tmp_path: Path, watch: Callable[..., Watch]) -> None:
    write_clip(tmp_path / "0.ts", 6)
    rig = watch(write_definition(tmp_path, ["0.ts", "0.ts"]), slowness=0.25)
    # a queue would be more than a second behind by then, and more with each further instant
    rig.wait(lambda: len(rig.seen) >= 5 and rig.now().latency_ns < 800_000_000)
    assert rig.now().dropped_stale >= 4 * 4
    assert [entry.numbers for entry in rig.seen] == [[entry.instant + rig.seen[0].numbers[0]] * 2 for entry in rig.seen]


def test_frames_can_be_chosen_counted_and_read_again(tmp_path: Path) -> None:
    write_clip(tmp_path / "0.ts", 1)
    dataset = open_live(write_definition(tmp_path, ["0.ts"] * 3, realtime=False), downscale=2)
    chosen = dataset.select(["cam2", "cam0"])
    assert chosen.names == ("cam2", "cam0")
    for _ in range(2):
        frames: list[FrameSet] = list(chosen.frames(5, 9))
        assert [frame.index for frame in frames] == [5, 6, 7, 8]
        assert frames[0].images.shape == (2, 64, 80, 3)
    assert chosen.statistics() is None


def _speaks_srt() -> bool:
    command = shutil.which("ffmpeg")
    if command is None:
        return False
    listed = subprocess.run([command, "-hide_banner", "-protocols"], capture_output=True, text=True, check=True)
    return "srt" in listed.stdout.split()


@pytest.mark.slow
@pytest.mark.skipif(not _speaks_srt(), reason="SRT needs a command ffmpeg that was built with it")
def test_srt_cameras_are_read_through_ffmpeg(tmp_path: Path, clip: Path, watch: Callable[..., Watch]) -> None:
    ports = free_ports(2)
    urls = [f"srt://127.0.0.1:{port}" for port in ports]
    outputs = [f"[f=mpegts]{url}?mode=listener" for url in urls]
    rig = watch(write_definition(tmp_path, [f"{url}?mode=caller" for url in urls]))
    with sending(clip, ("-map", "0", "-c", "copy", "-f", "tee", "|".join(outputs))):
        rig.wait(lambda: complete(rig) >= 30)
        assert all(entry.numbers[0] == entry.numbers[1] for entry in rig.seen)


_RTSP_SERVER = """
import sys, gi
gi.require_version("Gst", "1.0"); gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer
Gst.init(None)
server = GstRtspServer.RTSPServer()
server.set_service(sys.argv[2]); server.set_address("127.0.0.1")
factory = GstRtspServer.RTSPMediaFactory(); factory.set_shared(True)
factory.set_launch(f"( filesrc location={sys.argv[1]} ! tsdemux ! h264parse ! rtph264pay name=pay0 config-interval=1 )")
server.get_mount_points().add_factory("/live", factory)
server.attach(None); print("ready", flush=True); GLib.MainLoop().run()
"""


@pytest.mark.slow
def test_rtsp_cameras_that_are_pulled_agree_by_their_reports(
    tmp_path: Path, clip: Path, watch: Callable[..., Watch]
) -> None:
    """One source, pulled four times: all four must show the same number at any time."""
    (port,) = free_ports(1)
    command = ["/usr/bin/python3", "-c", _RTSP_SERVER, str(clip), str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as server:
        try:
            assert server.stdout is not None
            if not server.stdout.readline():
                pytest.skip("needs gst-rtsp-server for the system's Python (gir1.2-gst-rtsp-server-1.0)")
            rig = watch(write_definition(tmp_path, [f"rtsp://127.0.0.1:{port}/live"] * 4, {"quorum": 2}))
            rig.wait(lambda: complete(rig) >= 10 * FPS, 40)
            assert {camera.clock_source for camera in rig.now().cameras.values()} == {ClockSource.NTP}
            for entry in rig.seen:
                assert len({number for number in entry.numbers if number >= 0}) == 1
        finally:
            server.kill()
