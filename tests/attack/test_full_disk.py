"""Disks that are full: what is asked for is refused whole, and nothing half stays behind."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from streamlod.server.settings import Retention, Settings
from tests.server.conftest import Clip, running

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")


def full(folder: Path) -> None:
    """Let the next writing of a stream's definition meet a full disk."""
    (folder / "stream.new").symlink_to("/dev/full")


def test_below_the_reserve_no_stream_is_created(tmp_path: Path, clip: Clip) -> None:
    settings = Settings(state=tmp_path, retention=Retention(reserve_fraction=0.999999))
    with running(settings) as server, server.client() as client:
        answer = client.post("/v1/streams", json={"id": "new", "play": str(clip.path)})
        assert (answer.status_code, answer.headers["content-type"]) == (507, "application/problem+json")
        assert "full" in answer.json()["detail"]
        assert client.get("/v1/streams").json()["items"] == []
        assert client.get("/readyz").status_code == 503
    assert list((tmp_path / "streams").iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="the file system's own error")
def test_what_the_disk_does_not_take_is_refused_whole(tmp_path: Path, clip: Clip) -> None:
    body = {"id": "new", "play": str(clip.path)}
    folder = tmp_path / "streams" / "new"
    with running(Settings(state=tmp_path)) as server, server.client() as client:
        folder.mkdir()
        full(folder)
        answer = client.post("/v1/streams", json=body)
        assert (answer.status_code, answer.headers["content-type"]) == (507, "application/problem+json")
        assert "No space left" in answer.json()["detail"]
        assert client.get("/v1/streams").json()["items"] == []
        assert not folder.exists()
        assert client.post("/v1/streams", json=body).status_code == 201
        before = (folder / "stream.json").read_text()
        full(folder)
        assert client.delete("/v1/streams/new").status_code == 507
        assert json.loads(before) == json.loads((folder / "stream.json").read_text())
    with running(Settings(state=tmp_path)) as server:
        assert server.stream("new")["state"] == "idle"
