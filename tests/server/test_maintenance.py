"""What docs/maintenance.md says: a copy that was made while the server ran is a backup; the systemd unit is sound."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

from streamlod.server.cli.main import app
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.server.conftest import Clip, running

UNIT = Path(__file__).parents[2] / "docker" / "systemd" / "streamlod.service"


@pytest.mark.long
def test_a_copy_of_a_running_server_is_restored(clip: Clip, tmp_path: Path) -> None:
    state, backup = tmp_path / "state", tmp_path / "backup"
    ours = StreamSpec(id="ours", play=clip.path)
    source = "rtsp://admin:secret@192.0.2.1/x"
    camera = {
        "name": "a", "source": source, "width": 64, "height": 48, "intrinsics": [[60, 0, 32], [0, 60, 24], [0, 0, 1]],
        "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]],
    }  # fmt: skip
    networks = ("192.0.2.0/24",)
    with running(Settings(state=state, networks=networks), ours) as server, server.client() as client:
        body = {"id": "rest", "play": str(clip.path), "start": True}
        assert client.post("/v1/streams", json=body).status_code == 201
        rig = {"id": "rig", "live": {"fps": 10, "cameras": [camera]}}
        assert client.post("/v1/streams", json=rig).status_code == 201
        for name in ("ours", "rest"):
            server.wait(lambda stream: (stream["epoch"] or 0) >= 2, name)
        shutil.copytree(state, backup, ignore=shutil.ignore_patterns("lock"))
        before = {name: server.stream(name) for name in ("ours", "rest")}
        groups = {name: client.get(f"/v1/streams/{name}/manifest").json()["gops"] for name in ("ours", "rest")}
        data = {name: client.get(groups[name][0]["path"]).content for name in ("ours", "rest")}
    with running(Settings(state=backup, networks=networks), ours) as server, server.client() as client:
        for name in ("ours", "rest"):
            found = server.wait(lambda stream: stream["state"] == "live", name)
            assert found["incarnation"] == before[name]["incarnation"]
            again = client.get(f"/v1/streams/{name}/manifest").json()["gops"]
            assert {(g["epoch"], g["first"]) for g in groups[name] if g["begun_ns"]} <= {
                (g["epoch"], g["first"]) for g in again
            }
            assert client.get(groups[name][0]["path"]).content == data[name]
        spec = server.worker_stream("rig").spec
        assert spec.job.live["cameras"][0]["source"] == source


@pytest.mark.long
def test_a_folder_that_another_version_used_is_served_and_keeps_what_is_not_known(clip: Clip, tmp_path: Path) -> None:
    """As after a rollback: a field and files of a newer version, and the catalogue of an older one."""
    settings, spec = Settings(state=tmp_path / "state"), StreamSpec(id="ours", play=clip.path)
    with running(settings, spec) as server:
        server.wait(lambda stream: (stream["epoch"] or 0) >= 2, "ours")
        before = server.stream("ours")["incarnation"]
    path = tmp_path / "state" / "streams" / "ours" / "stream.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"new_field": [1]}))
    strange = (path.with_name("index.new-kind"), tmp_path / "state" / "catalogue.sqlite3")
    for each in strange:
        each.write_bytes(b"of another version")
    with running(settings, spec) as server, server.client() as client:
        found = server.wait(lambda stream: stream["state"] == "live", "ours")
        assert (found["incarnation"], found["epoch"] >= 3) == (before, True)
        groups = client.get("/v1/streams/ours/manifest").json()["gops"]
        assert groups[0]["epoch"] < found["epoch"]
        assert client.get(groups[0]["path"]).status_code == 200
        assert {each["stream"] for each in client.get("/v1/recordings").json()["items"]} == {"ours"}
    assert json.loads(path.read_text())["new_field"] == [1]
    assert all(each.read_bytes() == b"of another version" for each in strange)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing")
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("/opt/streamlod/bin/streamlod", sys.executable))
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_the_unit_starts_what_there_is() -> None:
    (command,) = re.findall(r"^ExecStart=\S+ (\w+) (.*)$", UNIT.read_text(), re.MULTILINE)
    known = {option for each in typer.main.get_group(app).commands[command[0]].params for option in each.opts}
    assert set(re.findall(r"--[\w-]+", command[1])) <= known
