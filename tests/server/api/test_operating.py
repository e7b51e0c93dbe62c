"""What an integrator's program does with a server: changes, viewers, events, recordings, streams on demand."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.codec.container import SlodReader
from streamlod.core.errors import InputError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from streamlod.server.stream.worker_stream import WorkerStream
from streamlod.server.worker.messages import Sender, Tag
from tests.attack.test_rights import bearer, close_code, write_tokens
from tests.server.conftest import UNWATCHED, Clip, Running, make_clip, running, viewing
from tests.waiting import wait


@pytest.fixture(scope="module")
def server(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """A recording server with one stream that plays."""
    with running(Settings(state=tmp_path_factory.mktemp("state"), on_demand_seconds=0.2), _play(clip)) as server:
        server.wait(lambda stream: stream["state"] == "live" and stream["version"] > 3)
        yield server


@pytest.fixture
def client(server: Running) -> Iterator[httpx.Client]:
    with server.client() as client:
        yield client


def _is_live_in(epoch: int, stream: dict[str, Any]) -> bool:
    return (stream["epoch"], stream["state"]) == (epoch, "live")


def _play(clip: Clip) -> StreamSpec:
    return StreamSpec(play=clip.path)


@pytest.mark.long
def test_every_get_has_its_head(client: httpx.Client) -> None:
    document = client.get("/openapi.json").json()
    incarnation = client.get("/v1/streams/main").json()["incarnation"]
    templates = [path for path, operations in document["paths"].items() if "get" in operations and "poster" not in path]
    numbers = {"epoch": 1, "version": 0, "first": 0, "last": 0, "number": 0}
    places = {"stream_id": "main", "incarnation": incarnation, "camera": "none", **numbers}
    for template in [*templates, "/", "/docs"]:
        path = template.format_map(places)
        asked = client.get(path, params={"seconds": 0.1})
        told = client.head(path)
        assert (told.status_code, told.content) == (asked.status_code, b""), path
        assert told.headers["content-type"] == asked.headers["content-type"], path
    assert "HEAD" in client.put("/v1/streams").headers["allow"]


def test_a_change_holds_only_for_what_was_read(client: httpx.Client, clip: Clip, tmp_path: Path) -> None:
    made = client.post("/v1/streams", json={"id": "changed", "play": str(clip.path)})
    tag, path = made.headers["etag"], "/v1/streams/changed"
    assert client.get(path).headers["etag"] == client.get(f"{path}/definition").headers["etag"] == tag
    kind = {"Content-Type": "application/merge-patch+json"}
    changed = client.patch(path, content=b'{"loop": false}', headers={"If-Match": tag, **kind})
    assert (changed.status_code, changed.json()["loop"]) == (200, False), changed.text
    newer = changed.headers["etag"]
    assert newer != tag
    for method, extra in (("PATCH", {"json": {"loop": True}}), ("DELETE", {}), ("POST", {})):
        where = f"{path}/start" if method == "POST" else path
        for old in (tag, f"W/{newer}", '"x"'):
            refused = client.request(method, where, headers={"If-Match": old}, **extra)  # type: ignore[arg-type]
            assert (refused.status_code, refused.headers["etag"]) == (412, newer), (method, old)
    other = make_clip(tmp_path / "other.slod", 3)
    assert client.patch(path, json={"play": str(other.path)}, headers={"If-Match": f'"x", {newer}'}).status_code == 200
    definition = client.get(f"{path}/definition").json()
    assert (definition["play"], definition["loop"]) == (str(other.path), False)
    assert client.patch(path, json={"loop": None}).json()["loop"] is True  # the default again
    for wrong in ({"play": None}, {"id": "other"}, {"fps": 3}, {"play": "/none.slod"}, {"loop": "perhaps"}):
        assert client.patch(path, json=wrong).status_code == 422, wrong
    assert client.get(f"{path}/definition").json()["play"] == str(other.path)
    assert client.post(f"{path}/start", headers={"If-Match": "*"}).status_code == 202
    assert client.patch(path, json={"loop": False}).status_code == 409  # it runs
    assert client.patch("/v1/streams/main", json={"loop": False}).status_code == 409  # of the settings
    assert client.delete(path, params={"erase": True}).status_code == 204


def test_a_changed_stream_is_the_changed_one_after_a_restart(clip: Clip, tmp_path: Path) -> None:
    settings = Settings(state=tmp_path)
    with running(settings) as server, server.client() as client:
        client.post("/v1/streams", json={"id": "new", "play": str(clip.path)})
        client.patch("/v1/streams/new", json={"loop": False, "on_demand": True})
    with running(settings) as server:
        assert server.stream("new")["loop"] is False


@pytest.mark.long
def test_a_stream_on_demand_runs_while_somebody_watches(server: Running, client: httpx.Client, slow_clip: Clip) -> None:
    made = client.post(
        "/v1/streams", json={"id": "asked", "play": str(slow_clip.path), "on_demand": True, "start": True}
    )
    assert (made.json()["state"], made.json()["detail"]) == ("idle", "it starts with its first viewer")
    assert client.get("/v1/streams/asked/ready").status_code == 200
    asked = server.registry.streams["asked"]
    assert isinstance(asked, WorkerStream)
    assert not asked.is_running
    for epoch in (1, 2):
        with ExitStack() as stack:
            viewer = stack.enter_context(viewing(server, "asked")).hello()
            viewer.until_version(3)
            second = stack.enter_context(viewing(server, "asked")).hello()
            viewer.connection.close()
            time.sleep(0.4)  # longer than a stream without viewers has
            second.next_packet()
            server.wait(partial(_is_live_in, epoch), "asked")
        server.wait(lambda stream: stream["state"] == "idle", "asked")
        assert not asked.is_running
    client.post("/v1/streams/asked/stop")
    assert server.stream("asked")["detail"] == ""
    with viewing(server, "asked") as viewer:
        viewer.hello()
        time.sleep(0.1)
        assert server.stream("asked")["state"] == "idle"
    assert client.delete("/v1/streams/asked", params={"erase": True}).status_code == 204


def test_a_stream_that_is_to_wait_no_more_for_a_viewer_starts(
    server: Running, client: httpx.Client, slow_clip: Clip
) -> None:
    body = {"id": "waiting", "play": str(slow_clip.path), "on_demand": True, "start": True}
    waiting = client.post("/v1/streams", json=body).json()
    assert (waiting["state"], waiting["detail"]) == ("idle", "it starts with its first viewer")
    assert client.patch("/v1/streams/waiting", json={"loop": False}).json()["detail"] == waiting["detail"]
    assert client.patch("/v1/streams/waiting", json={"on_demand": False}).json()["state"] == "starting"
    server.wait(lambda stream: stream["state"] == "live", "waiting")
    assert client.post("/v1/streams/waiting/stop").json()["state"] == "idle"
    assert client.patch("/v1/streams/waiting", json={"on_demand": True}).json()["state"] == "idle"
    with viewing(server, "waiting") as viewer:
        viewer.hello()
        assert client.get("/v1/streams/waiting").json()["state"] == "idle"  # it was stopped
    client.delete("/v1/streams/waiting")


def test_a_stream_on_demand_that_ended_plays_from_its_begin_for_the_next_viewer(clip: Clip, tmp_path: Path) -> None:
    settings = Settings(state=tmp_path, on_demand_seconds=0.1)
    with running(settings) as server, server.client() as client:
        body = {"id": "once", "play": str(clip.path), "loop": False, "on_demand": True, "start": True}
        assert client.post("/v1/streams", json=body).status_code == 201
        last = len(clip.states) - 1
        for epoch in (1, 2):
            with viewing(server, "once") as viewer:
                viewer.hello()
                server.wait(lambda stream, e=epoch: (stream["epoch"], stream["state"]) == (e, "ended"), "once")
            server.wait(lambda stream: stream["detail"] == "it starts with its first viewer", "once")
            groups = client.get("/v1/streams/once/manifest").json()["gops"]
            assert [(group["epoch"], group["first"]) for group in groups if group["first"] == 0][-1] == (epoch, 0)
            assert (groups[-1]["epoch"], groups[-1]["last"]) == (epoch, last)
    with running(settings) as server:  # and waits for one when the server starts again
        server.wait(lambda stream: stream["detail"] == "it starts with its first viewer", "once")


def test_viewers_are_listed_and_sent_away(server: Running, client: httpx.Client) -> None:
    with viewing(server) as one, viewing(server) as two:
        for viewer in (one, two):
            viewer.hello()
            viewer.next_packet()
        found = client.get("/v1/streams/main/viewers").json()["items"]
        assert [viewer["id"] for viewer in found] == [one.welcome["session"], two.welcome["session"]]
        assert found[0]["client"] == "test/1"
        assert (found[0]["address"], found[0]["mode"], found[0]["thin"]) == ("127.0.0.1", "live", False)
        assert found[0]["sent_bytes"] > 0
        path = f"/v1/streams/main/viewers/{one.welcome['session']}"
        assert client.delete(path).status_code == 204
        assert close_code(one.step) == 1008
        two.next_packet()
        while len(client.get("/v1/streams/main/viewers").json()["items"]) != 1:
            time.sleep(0.01)
        assert client.delete(path).status_code == 404
    assert client.get("/v1/streams/none/viewers").status_code == 404


class Reader:
    """Reads the event feed on a thread."""

    def __init__(self, server: Running, **options: Any) -> None:
        self.events: list[dict[str, Any]] = []
        self.answer: httpx.Response | None = None
        self._stack, self._options, self._server = ExitStack(), options, server
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        while self.answer is None:
            time.sleep(0.005)

    def _run(self) -> None:
        params = {"seconds": 60, **self._options.pop("params", {})}
        with (
            self._server.client(**{"timeout": 60, **self._options}) as client,
            client.stream("GET", "/v1/events", params=params) as answer,
        ):
            lines = answer.iter_lines()
            if answer.status_code == 200:
                next(lines)
            self.answer = answer
            for line in lines:
                if line.startswith("data: "):
                    self.events.append(json.loads(line[6:]))

    def until(self, count: int) -> list[tuple[str, str]]:
        wait(lambda: len(self.events) >= count)
        return [(event["type"], event["stream"]) for event in self.events]


def test_events_are_told_as_they_happen_and_again_to_those_who_were_away(
    server: Running, client: httpx.Client, clip: Clip
) -> None:
    reader = Reader(server, params={"stream": "told"})
    assert reader.answer is not None
    assert reader.answer.headers["content-type"].startswith("text/event-stream")
    client.post("/v1/streams", json={"id": "told", "play": str(clip.path), "start": True})
    server.wait(lambda stream: stream["state"] == "live", "told")
    with viewing(server, "told") as viewer:
        viewer.hello()
    client.delete("/v1/streams/told", params={"erase": True})
    kinds = [kind for kind, _ in reader.until(7)]
    expected = "stream.created stream.state stream.state viewer.joined viewer.left stream.state stream.deleted"
    assert kinds == expected.split()
    states = [event["data"]["state"] for event in reader.events if event["type"] == "stream.state"]
    assert states == ["starting", "live", "idle"]
    assert datetime.fromisoformat(reader.events[0]["at"]) > datetime.now(UTC) - timedelta(minutes=1)
    again = Reader(server, params={"stream": "told"}, headers={"Last-Event-ID": reader.events[3]["id"]})
    assert [kind for kind, _ in again.until(3)] == kinds[4:]
    unknown = Reader(server, params={"stream": "told"}, headers={"Last-Event-ID": "before-the-restart"})
    assert len(unknown.until(7)) == 7


@pytest.mark.long
def test_events_tell_each_token_what_it_may_know(clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.api.access.RECHECK_SECONDS", 0.2)
    grants: dict[str, Any] = {
        "all": {"rights": ["read", "control"]},
        "reader": {"rights": ["read"], "streams": "main"},
        "meter": {"rights": ["metrics"]},
    }
    settings = write_tokens(tmp_path, **grants)
    with running(settings, _play(clip), StreamSpec(id="secret", play=clip.path)) as server:
        boss, reader = (Reader(server, headers=bearer(name)) for name in ("all", "reader"))
        with viewing(server, additional_headers=bearer("reader")) as viewer:
            viewer.hello()
            viewer.next_packet()
        with server.client(headers=bearer("all")) as client:
            client.post("/v1/streams/secret/stop")
            client.post("/v1/streams/main/stop")
        seen = boss.until(4)
        assert {("viewer.joined", "main"), ("stream.state", "secret")} <= set(seen)
        wait(lambda: any(event["data"].get("state") == "idle" for event in reader.events))
        assert {(event["type"], event["stream"]) for event in reader.events} == {("stream.state", "main")}
        refused = Reader(server, headers=bearer("meter")).answer
        assert refused is not None
        assert refused.status_code == 403
        write_tokens(tmp_path, all=grants["all"])  # nobody sends a signal: the file is looked at
        with server.client(headers=bearer("reader")) as client:
            wait(lambda: client.get("/v1/streams/main").status_code == 401)
        reader._thread.join(60)
        assert not reader._thread.is_alive()
        with pytest.raises(ConnectionClosed), viewing(server, additional_headers=bearer("reader")) as viewer:
            viewer.connection.recv(60)


@pytest.mark.long
def test_a_web_token_is_withdrawn_by_its_name_or_hash(tmp_path: Path) -> None:
    import jwt

    from streamlod.server.auth.gate import hash_token

    revoked = tmp_path / "revoked"
    revoked.write_text("")
    settings = write_tokens(tmp_path).model_copy(update={"revoked": revoked})
    claims = {"exp": time.time() + 100, "aud": "streamlod", "lod": {"rights": ["read"]}}
    named, plain = jwt.encode(claims | {"jti": "page-7"}, "s" * 40, "HS256"), jwt.encode(claims, "s" * 40, "HS256")
    with running(settings, UNWATCHED) as server, server.client() as client:
        assert [client.get("/v1/streams", headers=bearer(token)).status_code for token in (named, plain)] == [200, 200]
        revoked.write_text(f"page-7  # lost phone\n{hash_token(plain)}\n")
        limit = time.monotonic() + 60
        while [client.get("/v1/streams", headers=bearer(token)).status_code for token in (named, plain)] != [401, 401]:
            assert time.monotonic() < limit
            time.sleep(0.2)


@pytest.mark.long
def test_recordings_are_listed_downloaded_by_time_and_deleted(clip: Clip, tmp_path: Path) -> None:
    with running(Settings(state=tmp_path), _play(clip)) as server, server.client() as client:
        client.post("/v1/streams", json={"id": "gone", "play": str(clip.path), "start": True})
        server.wait(lambda stream: (stream["epoch"] or 0) > 1)
        client.post("/v1/streams/main/stop")
        again = server.stream()["epoch"] + 1
        client.post("/v1/streams/main/start")
        server.wait(lambda stream: (stream["epoch"] or 0, stream["version"] or 0) > (again, 70))
        client.delete("/v1/streams/gone")
        client.post("/v1/streams/main/stop")
        page = client.get("/v1/recordings", params={"limit": 2}).json()
        found = page["items"] + client.get("/v1/recordings", params={"cursor": page["next_cursor"]}).json()["items"]
        places = [(each["stream"], each["epoch"], each["deleted"]) for each in found]
        assert ("gone", 1, True) in places
        assert ("main", again, False) in places
        gops = [gop for gop in client.get("/v1/streams/main/manifest").json()["gops"] if gop["begun_ns"] is not None]
        second, third = (datetime.fromtimestamp(gop["begun_ns"] / 1e9, UTC) for gop in gops[1:3])
        moment = timedelta(milliseconds=1)
        window = {"from": (second + moment).isoformat(), "to": (third - moment).isoformat()}
        path = tmp_path / "part.slod"
        for address in ("/v1/streams/main/bitstream", "/v1/recordings/main/bitstream"):
            path.write_bytes(client.get(address, params=window).content)
            with SlodReader(path) as reader:
                assert len(reader.entries) == gops[1]["packets"]
        assert client.get("/v1/recordings/main/bitstream").status_code == 409  # several runs
        one = client.get("/v1/recordings/gone/bitstream", params={"epoch": 1})
        assert (one.status_code, one.headers["accept-ranges"]) == (200, "bytes")
        for no_time in ("0.5", "1764147600", "2026-11-26", "yesterday"):
            refused = client.get("/v1/streams/main/bitstream", params={"from": no_time})
            assert (refused.status_code, "2026-11-26T09:00:00Z" in refused.text) == (422, True), no_time
        late = {"from": (datetime.now(UTC) + timedelta(hours=1)).isoformat(), "to": "3000-01-01T00:00:00Z"}
        last = client.get("/v1/recordings/main/bitstream", params=late)
        assert last.status_code == 200  # the last group lasts until another begins
        assert client.get("/v1/streams/main/bitstream", params={"to": "1999-01-01T00:00:00Z"}).status_code == 404
        assert (
            client.get("/v1/streams/main/bitstream", params={"from": window["to"], "to": window["from"]}).status_code
            == 422
        )
        assert client.delete("/v1/recordings/main", params={"epoch": 1}).status_code == 204
        assert client.delete("/v1/recordings/main", params={"epoch": 1}).status_code == 404
        assert client.get("/v1/streams/main/packets/1/0").status_code in {200, 410}  # memory may hold it
        assert not list((tmp_path / "streams" / "main").glob("000001-*"))
        assert client.delete("/v1/recordings/gone").status_code == 204
        assert not (tmp_path / "streams" / "gone").exists()
        assert client.delete("/v1/recordings/gone").status_code == 404
        assert {each["stream"] for each in client.get("/v1/recordings").json()["items"]} == {"main"}


def test_the_server_says_what_it_is(client: httpx.Client) -> None:
    found = client.get("/v1/server").json()
    assert found["protocol_versions"] == [1]
    assert found["limits"]["viewers"] == 1000
    assert (found["capabilities"]["recording"], found["capabilities"]["tokens"]) == (True, False)
    assert abs(found["server_time_ns"] - time.time_ns()) < 10e9


def test_a_server_names_its_edges(clip: Clip) -> None:
    edges = ("https://north.example", "https://south.example:8443")
    with running(Settings(edges=edges), _play(clip)) as server, server.client() as client:
        assert client.get("/v1/server").json()["edges"] == list(edges)
    with pytest.raises(InputError, match=r"'north\.example' is not an origin"):
        Settings(edges=("north.example",)).check()


def test_a_server_says_when_it_started_and_not_when_its_code_was_loaded(client: httpx.Client, clip: Clip) -> None:
    between = datetime.now(UTC)
    with running(Settings(), _play(clip)) as second, second.client() as other:
        first, later = (datetime.fromisoformat(each.get("/v1/server").json()["started_at"]) for each in (client, other))
    assert first < between < later < datetime.now(UTC)


def test_the_interface_is_shown_without_another_site(client: httpx.Client) -> None:
    page = client.get("/docs").text
    addresses = [part.split('"')[0] for mark in ('src="', 'href="') for part in page.split(mark)[1:]]
    assert len(addresses) >= 3
    for address in addresses:
        assert address.startswith("/docs/files/")
        assert client.get(address).status_code == 200
    assert "http" not in page.replace("http-equiv", "")


def _no_room(*arguments: Any) -> None:
    """In place of `server.worker.cluster.driver.run_on_ray`, in a process of its own: a cluster that is full."""
    pipe = arguments[3]
    Sender(pipe).send(Tag.FAILURE, {"text": "full", "fatal": True, "refused": {"text": "it needs 1 CPU", "ways": []}})


@pytest.mark.long
def test_a_stream_that_cannot_be_created_leaves_the_recording_of_an_earlier_one(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", _no_room)
    (tmp_path / "data").mkdir()
    again = {"id": "gone", "data": str(tmp_path / "data"), "start": True}
    with running(Settings(state=tmp_path / "state", jobs="ray")) as server, server.client(timeout=60) as client:
        client.post("/v1/streams", json={"id": "gone", "play": str(clip.path), "start": True})
        server.wait(lambda stream: (stream["version"] or 0) > 3, "gone")
        client.delete("/v1/streams/gone")
        before = client.get("/v1/recordings").json()["items"]
        assert before
        refused = client.post("/v1/streams", json=again)
        assert (refused.status_code, "it needs 1 CPU" in refused.text) == (409, True)
        assert client.get("/v1/recordings").json()["items"] == before
        (tmp_path / "state" / "streams" / "gone" / "stream.new").mkdir()  # so that nothing can be remembered
        assert client.post("/v1/streams", json=again).status_code == 507
        assert client.get("/v1/recordings").json()["items"] == before
        assert client.get("/v1/streams").json()["items"] == []


def test_a_stream_that_is_started_again_tells_no_progress_of_before(server: Running, client: httpx.Client) -> None:
    """It trains its first frame from the beginning, and none at all where it continues."""
    stream, told = server.worker_stream(), b'{"fraction": 0.6, "loss": 0.1, "text": "first frame"}'
    asyncio.run_coroutine_threadsafe(stream.work.on_message(Tag.PROGRESS, told), server.loop).result(60)
    assert client.post("/v1/streams/main/stop").json()["progress"]["fraction"] == 0.6
    assert client.post("/v1/streams/main/start").json()["progress"] is None
    server.wait(lambda stream: stream["state"] == "live")
