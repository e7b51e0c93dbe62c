"""An edge whose origin goes away and comes back, refuses it, or is hostile."""

from __future__ import annotations

import hashlib
import json
import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.e2e.test_server_process import recorded
from tests.server.conftest import Clip, Running, running, viewing
from tests.server.edge.processes import Node, node, wait_live
from tests.waiting import PATIENCE, wait


@pytest.fixture
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        found: int = probe.getsockname()[1]
        return found


@contextmanager
def edge_of(port: int, *, poll_seconds: float = 0.1, **settings: Any) -> Iterator[Running]:
    edge = EdgeSettings(origin=f"http://127.0.0.1:{port}", poll_seconds=poll_seconds, linger_seconds=0.2)
    with running(Settings(edge=edge, **settings)) as server:
        yield server


def knows(edge: Running) -> Callable[[], bool]:
    """Whether the edge has been told of the stream."""
    return lambda: "main" in edge.registry.streams


@pytest.mark.cluster
def test_viewers_stay_while_the_origin_is_killed_and_comes_back(
    slow_long_clip: Clip, tmp_path: Path, port: int
) -> None:
    """With its state folder it goes on with the next epoch of the same incarnation."""
    serve = ("serve", *recorded(tmp_path / "state", slow_long_clip))
    with ExitStack() as stack:
        origin: Node = stack.enter_context(node(tmp_path, *serve, port=port))
        edge = stack.enter_context(edge_of(port))
        client = stack.enter_context(edge.client())
        wait(knows(edge))
        viewer = stack.enter_context(viewing(edge, max_queue=None)).hello()
        viewer.until("caught_up")
        for _ in range(60):
            viewer.next_packet()
        origin.kill()
        lost = viewer.until("state")
        assert lost["state"] == "degraded"
        assert "origin" in lost["detail"]
        assert str(port) not in lost["detail"]
        held = client.get("/v1/streams/main/manifest").json()
        assert client.get(held["gops"][0]["path"]).status_code == 200
        with viewing(edge, max_queue=None) as late:  # who comes now sees the last picture
            assert late.hello().welcome["state"] == "degraded"
            late.until("caught_up")
            assert late.decoder.scene is not None
        again = stack.enter_context(node(tmp_path, *serve, port=port))
        wait_live(again)
        viewer.until("epoch")
        viewer.next_packet()
        assert viewer.named("epoch")[-1]["epoch"] == 2
        viewer.until_version(60)
        manifest = client.get("/v1/streams/main/manifest").json()
        assert manifest["incarnation"] == again.stream()["incarnation"] == held["incarnation"]
        same = [client.get(g["path"]).content == again.get(g["path"]).content for g in manifest["gops"][:-1]]
        assert same
        assert all(same)  # whatever is called immutable is what the origin recorded


def test_viewers_are_told_to_come_again_when_the_origin_begins_anew(long_clip: Clip, port: int) -> None:
    """Without a state folder it has another incarnation, the positions of which mean other packets."""
    spec = StreamSpec(play=long_clip.path)
    with ExitStack() as stack, ExitStack() as first:
        origin = first.enter_context(running(Settings(), spec, port=port))
        edge = stack.enter_context(edge_of(port, poll_seconds=60.0))  # it hears of the new one when it pulls
        wait(knows(edge))
        viewer = stack.enter_context(viewing(edge, max_queue=None)).hello()
        viewer.until("caught_up")
        assert viewer.welcome["incarnation"] == origin.stream()["incarnation"]
        first.close()
        origin = stack.enter_context(running(Settings(), spec, port=port))
        with pytest.raises(ConnectionClosed) as caught:
            viewer.until("nothing that it sends")
        assert caught.value.rcvd is not None
        assert caught.value.rcvd.code == 1001
        with viewing(edge, max_queue=None) as viewer:
            assert viewer.hello().welcome["incarnation"] == origin.stream()["incarnation"]
            viewer.until("caught_up")


def test_viewers_of_a_stream_that_the_origin_deletes_are_told_so(long_clip: Clip, port: int) -> None:
    with running(Settings(), StreamSpec(play=long_clip.path), port=port) as origin, edge_of(port) as edge:
        wait(knows(edge))
        with viewing(edge, max_queue=None) as viewer:
            viewer.hello().until("caught_up")
            with origin.client() as client:
                client.delete("/v1/streams/main")
            with pytest.raises(ConnectionClosed) as caught:
                viewer.until("nothing that it sends")
            assert caught.value.rcvd is not None
            assert caught.value.rcvd.code == 1000
        wait(lambda: not knows(edge)())  # a look at the origin from before may end after this


def test_an_edge_checks_tokens_itself_and_shows_the_origin_its_own(
    long_clip: Clip, tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def file_of(token: str) -> Path:
        digest = hashlib.sha256(token.encode()).hexdigest()
        path = tmp_path / f"{token}.json"
        path.write_text(json.dumps([{"name": token, "sha256": digest, "rights": ["read"]}]))
        return path

    spec = StreamSpec(play=long_clip.path)
    with running(Settings(tokens=file_of("for-edges")), spec, port=port) as origin:
        with edge_of(port, poll_seconds=0.02, tokens=file_of("for-viewers")) as edge, edge.client() as client:
            answer = client.get("/readyz")  # it has no token for the origin
            assert answer.status_code == 503
            assert "origin" in answer.json()["detail"]
            wait(lambda: "answers 401" in caplog.text)
            monkeypatch.setenv("STREAMLOD_TOKEN", "for-edges")
            with caplog.at_level(logging.INFO, "httpx"), edge_of(port, poll_seconds=0.02):
                wait(
                    lambda: caplog.text.count("/v1/streams?limit=200") > 10
                )  # as often as another edge looks meanwhile
            assert origin.registry.gate.refused == 1  # else it would shut out all who share the edge's address
            token = {"Authorization": "Bearer for-viewers"}
            with viewing(edge, additional_headers=token) as viewer, pytest.raises(ConnectionClosed) as caught:
                viewer.connection.recv(60)
            assert caught.value.rcvd is not None
            assert caught.value.rcvd.code == 1013  # to be tried again
        with edge_of(port, tokens=file_of("for-viewers")) as edge, edge.client() as client:
            wait(lambda: client.get("/readyz").status_code == 200)
            with viewing(edge, additional_headers=token, max_queue=None) as viewer:
                viewer.hello().until("caught_up")
            refused = {"Authorization": "Bearer for-edges"}
            with viewing(edge, additional_headers=refused) as viewer, pytest.raises(ConnectionClosed) as caught:
                viewer.connection.recv(60)
            assert caught.value.rcvd is not None
            assert caught.value.rcvd.code == 4401


def test_an_edge_that_cannot_reach_its_origin_tells_the_log_where_that_is_and_each_reason_once(
    port: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with edge_of(port) as edge, edge.client() as client:
        wait(lambda: f"127.0.0.1:{port}" in caplog.text)
        answer = client.get("/readyz")
        assert (answer.status_code, answer.json()["detail"]) == (503, "the origin has not been reached yet")
        with socket.create_server(("127.0.0.1", port)) as mute:
            mute.settimeout(PATIENCE)
            for _ in range(4):
                with mute.accept()[0] as connection:
                    connection.recv(4096)
        tokens = tmp_path / "tokens.json"
        tokens.write_text(json.dumps([{"name": "other", "sha256": "0" * 64, "rights": ["read"]}]))
        with running(Settings(tokens=tokens), port=port):
            wait(lambda: "answers 401" in caplog.text)
        warnings = [record.getMessage() for record in caplog.records if "does not say" in record.getMessage()]
        assert len(warnings) == len(set(warnings))
