"""An origin that says what it likes: the edge refuses it, stays up, and serves it once it behaves."""

from __future__ import annotations

import http
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from streamlod.server.settings import EdgeSettings, Limits, Settings
from tests.server.conftest import Clip, running, viewing
from tests.waiting import wait

STREAM = {
    "id": "main", "incarnation": "0123456789abcdef", "source": "data", "loop": False, "state": "live", "detail": "",
    "created_at": "2026-11-21T10:00:00Z",
}  # fmt: skip
WELCOME = {"type": "welcome", "version": 1, "incarnation": "0123456789abcdef", "state": "live", "detail": "",
           "ack_every": 32, "server_time_ns": time.time_ns()}  # fmt: skip
Speech = Callable[[ServerConnection], None]


@dataclass(slots=True)
class Origin:
    """What it says: a list of streams, `asked` for so often, and over the websocket whatever `speak` sends."""

    speak: Speech
    listing: str = json.dumps({"items": [STREAM], "next_cursor": None})
    port: int = 0
    hellos: list[dict[str, Any]] = field(default_factory=list)
    asked: int = 0

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        if not request.path.startswith("/v1/streams?"):
            return None
        self.asked += 1
        return connection.respond(http.HTTPStatus.OK, self.listing)

    def is_asked_again(self) -> None:
        """Wait until the edge has taken over a list that it asked for after now."""
        before = self.asked
        wait(lambda: self.asked > before + 1)

    def talk(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed):
            self.hellos.append(json.loads(connection.recv(60)))
            self.speak(connection)
            while True:
                connection.recv(60)


@contextmanager
def origin_that(speak: Speech) -> Iterator[Origin]:
    origin = Origin(speak)
    with serve(
        origin.talk, "127.0.0.1", 0, process_request=origin.answer, subprotocols=["streamlod.v1"], compression=None  # type: ignore[list-item]
    ) as server:  # fmt: skip
        origin.port = server.socket.getsockname()[1]
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield origin
        server.shutdown()
        thread.join(60)


def settings(origin: Origin) -> Settings:
    edge = EdgeSettings(origin=f"http://127.0.0.1:{origin.port}", poll_seconds=0.05)
    return Settings(edge=edge, limits=Limits(packet_bytes=65536))


def behaves(clip: Clip) -> Speech:
    def speak(connection: ServerConnection) -> None:
        connection.send(json.dumps(WELCOME))
        connection.send(json.dumps({"type": "event", "event": "epoch", "epoch": 1}))
        for packet in clip.packets[:10]:
            connection.send(packet)

    return speak


SPEECHES: dict[str, list[str | bytes]] = {
    "no packet": [json.dumps(WELCOME), bytes(100)],
    "an empty packet": [json.dumps(WELCOME), b""],
    "a packet that follows nothing": [json.dumps(WELCOME), "residual"],
    "a damaged packet": [json.dumps(WELCOME), "damaged"],
    "a packet that is too large": [json.dumps(WELCOME), bytes(70_000)],
    "another stream": [json.dumps(WELCOME | {"incarnation": "f" * 16})],
    "a welcome without an incarnation": ['{"type":"welcome","version":1}'],
    "no welcome": ["[]"],
    "no JSON": ["{"],
    "a binary welcome": [bytes(10)],
    "numbers without end": [json.dumps(WELCOME | {"ack_every": 10**30, "server_time_ns": -(10**30), "state": [1]})],
    "strange events": [
        json.dumps(WELCOME),
        *(
            json.dumps({"type": "event"} | fields)
            for fields in (
                {"event": "epoch", "epoch": -1}, {"event": "epoch", "epoch": 2**70}, {"event": "state", "state": {}},
                {"event": ["epoch"]}, {"event": "progress"}, {"event": "skipped"}, {},
            )
        ),
    ],
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", SPEECHES)
def test_what_the_origin_says_wrong_harms_nobody(name: str, clip: Clip, caplog: pytest.LogCaptureFixture) -> None:
    damaged = bytearray(clip.packets[0])
    damaged[len(damaged) // 2] ^= 1
    words = {"residual": clip.packets[1], "damaged": bytes(damaged)}
    said = threading.Event()

    def speak(connection: ServerConnection) -> None:
        for message in SPEECHES[name]:
            connection.send(words.get(message, message) if isinstance(message, str) else message)
        time.sleep(0.2)
        said.set()
        connection.close()

    with origin_that(speak) as origin, running(settings(origin)) as edge, edge.client() as client:
        wait(lambda: "main" in edge.registry.streams)
        with viewing(edge) as viewer, suppress(ConnectionClosed):
            viewer.hello()
            assert said.wait(5)
        assert client.get("/healthz").status_code == 200
        origin.speak = behaves(clip)
        limit = time.monotonic() + 60
        while True:  # it is pulled for a while after that viewer, or as soon as the next one comes
            with viewing(edge) as viewer, suppress(ConnectionClosed, TimeoutError):
                viewer.hello()
                viewer.until_version(9)
                break
            assert time.monotonic() < limit
    assert origin.hellos[0]["relay"] is True
    assert not [record for record in caplog.records if record.exc_info and record.name.startswith("streamlod.server")]


LISTINGS = {
    "no JSON": "<html>",
    "no list": '{"items": 7}',
    "a name that is a path": json.dumps({"items": [STREAM | {"id": "../secret"}]}),
    "an incarnation that is a path": json.dumps({"items": [STREAM | {"incarnation": "../../../secret!"}]}),
    "a cursor without end": json.dumps({"items": [], "next_cursor": "main"}),
    "five megabytes": json.dumps({"items": [STREAM] * 20_000}) + " " * (1 << 20),
    "deep nesting": '{"items":' + "[" * 100_000,
}


@pytest.mark.parametrize("name", LISTINGS)
def test_a_list_of_streams_that_cannot_be_used_is_refused(
    name: str, clip: Clip, caplog: pytest.LogCaptureFixture
) -> None:
    with origin_that(behaves(clip)) as origin:
        origin.listing = LISTINGS[name]
        with caplog.at_level(logging.INFO), running(settings(origin)) as edge:
            wait(lambda: "does not say which streams there are" in caplog.text, 60)  # it asks up to a hundred times
            assert edge.registry.streams == {}
            with edge.client() as client:
                assert client.get("/readyz").status_code == 503


def test_an_origin_of_another_version_of_the_protocol_is_named_as_the_reason(clip: Clip) -> None:
    def speak(connection: ServerConnection) -> None:
        connection.send(json.dumps(WELCOME | {"version": 2, "packets": "of another kind"}))
        connection.send(clip.packets[0])

    with origin_that(speak) as origin, running(settings(origin)) as edge:
        wait(lambda: "main" in edge.registry.streams)
        with viewing(edge) as viewer:
            assert viewer.hello().welcome["version"] == 1
            told = viewer.until("state")
            assert told["state"] == "degraded"
            assert "the origin speaks version 2 of the protocol, not 1" in told["detail"]
            assert not viewer.packets


def test_streams_of_a_kind_that_only_later_versions_know_are_left_out_alone(
    clip: Clip, caplog: pytest.LogCaptureFixture
) -> None:
    with origin_that(behaves(clip)) as origin:
        later = [STREAM | {"id": "later", "state": "rehearsing"}, STREAM | {"id": "latest", "source": "hologram"}]
        origin.listing = json.dumps({"items": [*later, STREAM | {"news": [1]}], "next_cursor": None, "total": 3})
        with running(settings(origin)) as edge:
            wait(lambda: "main" in edge.registry.streams)
            with viewing(edge) as viewer:
                viewer.hello().until_version(9)
            origin.is_asked_again()
            assert set(edge.registry.streams) == {"main"}
    assert len([line for line in caplog.messages if "does not know: later, latest" in line]) == 1


def test_a_stream_that_is_served_stays_when_its_state_gets_a_name_that_only_later_versions_know(clip: Clip) -> None:
    with origin_that(behaves(clip)) as origin, running(settings(origin)) as edge:
        wait(lambda: "main" in edge.registry.streams)
        served = edge.registry.streams["main"]
        origin.listing = json.dumps({"items": [STREAM | {"state": "rehearsing"}], "next_cursor": None, "total": 1})
        origin.is_asked_again()
        assert edge.registry.streams == {"main": served}
        with viewing(edge) as viewer:
            viewer.hello().until_version(9)


def test_only_so_many_streams_as_the_limits_allow(clip: Clip) -> None:
    with origin_that(behaves(clip)) as origin:
        names = [f"s{number:02d}" for number in range(30)]
        origin.listing = json.dumps({"items": [STREAM | {"id": name} for name in names]})
        with running(settings(origin)) as edge:
            origin.is_asked_again()
            assert sorted(edge.registry.streams) == names[:16]
