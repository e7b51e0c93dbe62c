"""What a server finds again when it starts, and what it makes of what lies in its folder."""

from __future__ import annotations

import json
import stat
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from streamlod.codec.container import SlodReader
from streamlod.codec.packet.info import peek
from streamlod.core.errors import InputError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Retention, Settings
from streamlod.server.stream.recording.store import Store
from tests.server.conftest import Clip, Viewer, make_clip, running, viewing


def create(client: httpx.Client, **fields: Any) -> None:
    made = client.post("/v1/streams", json=fields)
    assert made.status_code == 201, made.text


def test_streams_of_rest_start_again_as_they_were(tmp_path: Path, clip: Clip) -> None:
    settings = Settings(state=tmp_path)
    with running(settings) as server, server.client() as client:
        create(client, id="runs", play=str(clip.path), start=True)
        create(client, id="idle", play=str(clip.path))
        create(client, id="stopped", play=str(clip.path), start=True)
        create(client, id="deleted", play=str(clip.path))
        for name in ("runs", "stopped"):
            server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 5, name)
        client.post("/v1/streams/stopped/stop")
        client.delete("/v1/streams/deleted")
        before = {stream["id"]: stream for stream in client.get("/v1/streams").json()["items"]}
    with running(settings) as server, server.client() as client:
        runs = server.wait(lambda stream: stream["state"] == "live", "runs")
        assert runs["epoch"] > before["runs"]["epoch"]
        stopped = server.wait(lambda stream: stream["version"] is not None, "stopped")  # its past can be seen
        assert (stopped["state"], server.stream("idle")["state"]) == ("idle", "idle")
        for name in ("runs", "stopped"):
            assert server.stream(name)["incarnation"] == before[name]["incarnation"]
            assert server.stream(name)["created_at"] == before[name]["created_at"]
        assert client.get("/v1/streams/deleted").status_code == 404
        window = client.get("/v1/streams/stopped/manifest").json()["window"]
        assert window["oldest"] == {"epoch": 1, "version": 0}
        with viewing(server, "stopped") as viewer:
            viewer.hello(start={"epoch": 1, "version": 0})
            viewer.until_version(3)


def test_a_failed_stream_does_not_make_the_others_unready(tmp_path: Path, clip: Clip) -> None:
    specs = StreamSpec(play=clip.path), StreamSpec(id="bad", play=tmp_path / "none.slod")
    with running(Settings(), *specs) as server, server.client() as client:
        server.wait(lambda stream: stream["state"] == "failed", "bad")
        server.wait(lambda stream: stream["state"] == "live")
        assert client.get("/readyz").status_code == 200
        assert client.get("/v1/streams/main/ready").status_code == 200
        unready = client.get("/v1/streams/bad/ready")
        assert (unready.status_code, unready.json()["status"]) == (503, "failed")


def test_streams_of_the_settings_that_are_not_to_start_do_not(clip: Clip) -> None:
    tables = [
        {"id": "idle", "play": str(clip.path), "start": False},
        {"id": "runs", "play": str(clip.path)},
    ]
    settings = Settings.model_validate({"streams": tables})
    with running(settings, *(new.spec for new in settings.streams)) as server:
        server.wait(lambda stream: stream["state"] == "live", "runs")
        assert server.stream("idle")["state"] == "idle"


def test_two_servers_do_not_share_a_folder(tmp_path: Path) -> None:
    first = Store(tmp_path, Retention())
    with pytest.raises(InputError, match="another server"):
        Store(tmp_path, Retention())
    code = f"from streamlod.server.stream.recording.store import *; Store(Path({str(tmp_path)!r}), Retention())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "another server" in other.stderr
    first.close()
    Store(tmp_path, Retention()).close()


def test_strange_files_in_the_folder_are_reported_and_left_alone(
    tmp_path: Path, clip: Clip, caplog: pytest.LogCaptureFixture
) -> None:
    settings = Settings(state=tmp_path)
    folder = tmp_path / "streams" / "main"
    folder.mkdir(parents=True)
    strange = [folder / name for name in ("notes.txt", "a-b.slod", "x-0000000001.slod", "1-2-3.slod")]
    strange += [tmp_path / "streams" / "README", folder / "000001-0000000000.slod.bak"]
    for path in strange:
        path.write_text("mine")
    (tmp_path / "streams" / "damaged").mkdir()
    (tmp_path / "streams" / "damaged" / "stream.json").write_text('{"incarnation": 3}')
    with running(settings, StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
    assert all(path.read_text() == "mine" for path in strange)
    for path in strange:
        assert path.name in caplog.text
    assert "damaged" in caplog.text


def test_nobody_else_may_read_what_is_kept(tmp_path: Path, clip: Clip) -> None:
    with running(Settings(state=tmp_path / "state"), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        server.wait(lambda stream: stream["version"] > 3)
        with server.client() as client:
            client.post("/v1/streams/main/stop")  # while it runs, files come and go
        server.wait(lambda stream: stream["state"] == "idle")
        for path in (tmp_path / "state").rglob("*"):
            mode = stat.S_IMODE(path.stat().st_mode)
            assert mode == (0o700 if path.is_dir() else 0o600), path


@pytest.mark.long
def test_old_recordings_are_deleted_though_no_packet_comes(tmp_path: Path, clip: Clip) -> None:
    settings = Settings(state=tmp_path, retention=Retention(seconds=2.5))
    with running(settings, StreamSpec(play=clip.path, loop=False)) as server:
        server.wait(lambda stream: stream["state"] == "ended")
        limit = time.monotonic() + 60
        while list((tmp_path / "streams" / "main").glob("*.slod")):
            assert time.monotonic() < limit
            time.sleep(0.1)
    assert json.loads((tmp_path / "streams" / "main" / "stream.json").read_text())["epoch"] == 1


@pytest.fixture(scope="module")
def one_file(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    """A minute at ten frames a second, recorded into one file, as it has one keyframe."""
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 600, (5, 10), frame_ns=100_000_000)


def recorded_version(folder: Path) -> int:
    """The newest version of the stream `main` on the disk."""
    (path,) = (folder / "streams" / "main").glob("*.slod")
    with SlodReader(path) as reader:
        return reader.entries[-1].to_version


def next_version(viewer: Viewer) -> int:
    """The version of the next packet that a viewer gets."""
    while not isinstance(packet := viewer.step(), bytes):
        pass
    return peek(packet).to_version


def test_what_a_viewer_got_is_on_the_disk_already(
    tmp_path: Path, one_file: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.stream.bus._RECORD_SECONDS", 30.0)  # no disk is that slow
    with running(Settings(state=tmp_path), StreamSpec(play=one_file.path)) as server, viewing(server) as viewer:
        viewer.hello()
        viewer.until("caught_up")
        store = server.registry.store
        assert store is not None
        for number in range(12):
            if number % 4 == 0:
                store.disk.submit(partial(time.sleep, 0.3))  # a disk that is slow now and then
            version = next_version(viewer)
            assert recorded_version(tmp_path) >= version


def test_a_disk_that_stands_still_holds_viewers_up_once(
    tmp_path: Path, one_file: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, free = threading.Event(), threading.Event()

    def stand_still() -> None:
        held.set()
        free.wait(100)

    with running(Settings(state=tmp_path), StreamSpec(play=one_file.path)) as server, viewing(server) as viewer:
        viewer.hello()
        viewer.until("caught_up")
        store = server.registry.store
        assert store is not None
        store.disk.submit(stand_still)
        try:
            assert held.wait(20)
            recorded = recorded_version(tmp_path)
            while next_version(viewer) <= recorded:
                pass
            monkeypatch.setattr(
                "streamlod.server.stream.bus._RECORD_SECONDS", 60.0
            )  # from now on, a wait would be noticed
            for _ in range(20):
                viewer.next_packet()
        finally:
            free.set()
