"""The REST client against a real server, and the command that uses it."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from streamlod.client.remote import remote
from streamlod.client.rest import ServerClient
from streamlod.client.rest_answers import FeedEvent
from streamlod.codec.container import SlodReader
from streamlod.core.errors import InputError, RequestRefused
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.attack.test_rights import write_tokens
from tests.server.conftest import UNWATCHED, Clip, Running, clip, running, slow_clip, viewing

__all__ = ["clip", "slow_clip"]


@pytest.fixture(scope="module")
def server(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(Settings(state=tmp_path_factory.mktemp("state")), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 3)
        yield server


def test_a_stream_from_its_creation_to_its_end(server: Running, slow_clip: Clip, tmp_path: Path) -> None:
    with ServerClient(server.url) as client:
        assert client.server()["protocol_versions"] == [1]
        made = client.create("new", {"play": str(slow_clip.path)})
        assert (made.id, made.state, made.version) == ("new", "idle", None)
        assert [stream.id for stream in client.streams()] == ["main", "new"]
        changed = client.change("new", {"loop": False}, etag=made.etag)
        assert client.definition("new")["loop"] is False
        with pytest.raises(RequestRefused) as caught:
            client.change("new", {"loop": True}, etag=made.etag)
        assert (caught.value.status, client.stream("new").etag) == (412, changed.etag)
        assert client.start("new").state in {"starting", "live"}
        server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 3, "new")
        assert client.stop("new").state == "idle"
        found = client.recordings(end=datetime.now(UTC) + timedelta(seconds=1))  # main's, an epoch a repetition, too
        (recorded,) = [recording for recording in found if recording.stream == "new"]
        assert (recorded.stream, recorded.epoch, recorded.deleted) == ("new", 1, False)
        path = tmp_path / "new.slod"
        assert client.download("new", path, begin=recorded.begun_at, epoch=1) == path.stat().st_size
        with SlodReader(path) as reader:
            assert len(reader.entries) == recorded.packets
        client.delete("new")
        client.erase("new")
        for gone in (lambda: client.erase("new"), lambda: client.download("new", path), lambda: client.stream("new")):
            with pytest.raises(RequestRefused, match="404"):
                gone()
        assert path.is_file()
        assert [each.name for each in tmp_path.iterdir()] == ["new.slod"]


def test_viewers_and_events(server: Running) -> None:
    seen: list[FeedEvent] = []
    with ServerClient(server.url) as client, viewing(server) as viewer:

        def read() -> None:
            for event in client.events("main", last_id=""):
                seen.append(event)
                if event.type == "viewer.left":
                    return

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        viewer.hello()
        with ServerClient(server.url) as other:
            (found,) = other.viewers("main")
            assert (found.id, found.client) == (viewer.welcome["session"], "test/1")
            other.disconnect("main", found.id)
        reader.join(60)
        assert not reader.is_alive()
    assert seen[-1].data["viewer"] == found.id


def test_the_command_controls_a_server(server: Running, clip: Clip, tmp_path: Path) -> None:
    fields = {"play": str(clip.path), "start": True}
    assert json.loads(next(remote(server.url, "create", "told", fields)))["id"] == "told"
    server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 3, "told")
    assert [json.loads(line)["id"] for line in remote(server.url, "list")] == ["main", "told"]
    assert json.loads("".join(remote(server.url, "show", "told")))["play"] == str(clip.path)
    out = tmp_path / "main.slod"
    assert str(out) in "".join(remote(server.url, "download", "main", {"epoch": 1}, out))
    assert list(remote(server.url, "delete", "told", {"erase": False})) == []
    with ServerClient(server.url) as client:
        assert "told" in [recording.stream for recording in client.recordings()]
    assert json.loads(next(remote(server.url, "create", "told", fields)))["id"] == "told"
    assert list(remote(server.url, "delete", "told", {"erase": True})) == []
    with ServerClient(server.url) as client:
        assert "told" not in [recording.stream for recording in client.recordings()]
    for arguments in (("fly",), ("start",), ("recordings", None, {"from": "noon"})):
        with pytest.raises(InputError):
            list(remote(server.url, *arguments))  # type: ignore[arg-type]


def test_refusals_are_errors_of_ours(tmp_path: Path) -> None:
    with running(write_tokens(tmp_path), UNWATCHED) as server:
        with ServerClient(server.url, token="wrong") as client, pytest.raises(RequestRefused) as caught:
            client.streams()
        assert (caught.value.status, str(caught.value)) == (401, "a valid token is needed [401]")
    with ServerClient(server.url) as client, pytest.raises(InputError, match="is the server running"):
        client.streams()
    with pytest.raises(InputError, match="none"):
        ServerClient("https://localhost", ca=tmp_path / "none.pem")
