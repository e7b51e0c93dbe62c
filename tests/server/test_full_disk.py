"""A disk that is full when the server starts: no stream is lost, nothing unchanged is written, recording comes back."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Retention, Settings
from tests.server.conftest import Clip, running
from tests.small_disk import mounted_disk

pytestmark = pytest.mark.long


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of four megabytes."""
    with mounted_disk(tmp_path / "disk") as folder:
        yield folder


def fill(disk: Path) -> Path:
    """Take all that is left of a disk."""
    path = disk / "fill"
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(512))
        except OSError:
            return path


def state(folder: Path) -> dict[Path, tuple[int, int, int]]:
    """What tells whether a file was written, of all that is kept of streams."""
    found = {path: path.stat() for path in sorted((folder / "streams").rglob("*")) if path.is_file()}
    return {path: (stat.st_mtime_ns, stat.st_ino, stat.st_size) for path, stat in found.items()}


def test_streams_are_there_on_a_full_disk_and_record_when_there_is_room(disk: Path, clip: Clip) -> None:
    folder = disk / "state"
    settings = Settings(state=folder, retention=Retention(reserve_fraction=0, bytes=1_000_000))
    ours = StreamSpec(id="ours", play=clip.path)
    with running(settings, ours) as server, server.client() as client:
        body = {"id": "rest", "play": str(clip.path), "start": True}
        assert client.post("/v1/streams", json=body).status_code == 201
        for name in ("ours", "rest"):
            server.wait(lambda stream: stream["state"] == "live", name)
    room = fill(disk)
    before = state(folder)
    with running(settings, ours, StreamSpec(id="new", play=clip.path)) as server:
        for name in ("ours", "rest", "new"):
            server.wait(lambda stream: stream["state"] == "live", name)
        for name in ("ours", "rest", "new"):
            server.wait(lambda stream: "stopped" in stream["recording"], name)
        now = state(folder)
        assert {path: now.get(path) for path in before} == before
        room.unlink()
        for name in ("ours", "rest", "new"):
            server.wait(lambda stream: stream["recording"] == "on", name)
        limit = time.monotonic() + 120
        while not list((folder / "streams" / "new").glob("*.slod")):
            assert time.monotonic() < limit
            time.sleep(0.05)
