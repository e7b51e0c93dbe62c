"""The client against websocket servers that behave, break, refuse and lie."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from http import HTTPStatus

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

import streamlod.client.connection.edges
import streamlod.client.connection.moving_link
import streamlod.client.connection.watch
import streamlod.client.playback
from streamlod.client.connection.address import live_address
from streamlod.client.connection.link import SUBPROTOCOL, WatchOptions
from streamlod.client.connection.watch import back_off, watch
from streamlod.client.events import Disconnected, Event, NewScene, Notice, Welcome
from streamlod.codec.encoder import encode_residual
from streamlod.core.errors import InputError, SessionError
from streamlod.core.scene.residual import difference
from tests.client.clips import FRAME_NS, packets, states
from tests.client.test_playback import WELCOME

Behaviour = Callable[[ServerConnection], Awaitable[None]]


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between two attempts; and where the machine is busy, nothing is given up, or acknowledged early."""
    monkeypatch.setattr(streamlod.client.connection.watch, "_MIN_DELAY", 0.01)
    monkeypatch.setattr(streamlod.client.connection.edges, "_ANSWER_SECONDS", 30.0)
    monkeypatch.setattr(streamlod.client.connection.moving_link, "_MOVE_SECONDS", 30.0)
    monkeypatch.setattr(streamlod.client.playback, "_ACK_SECONDS", 60.0)


def events_from(*behaviours: Behaviour, options: WatchOptions | None = None) -> list[Event]:
    """What `watch` tells when the n-th connection meets the n-th behaviour."""
    waiting = list(behaviours)

    async def handle(socket: ServerConnection) -> None:
        await waiting.pop(0)(socket)

    async def run() -> list[Event]:
        async with serve(handle, "127.0.0.1", 0, subprotocols=[SUBPROTOCOL], compression=None) as server:  # type: ignore[list-item]
            port = server.sockets[0].getsockname()[1]
            url = f"ws://127.0.0.1:{port}/v1/streams/main/live"
            async with aclosing(watch(url, options or WatchOptions(), attempts=3)) as events:
                return [event async for event in events]

    return asyncio.run(run())


async def welcome(socket: ServerConnection) -> dict[str, object]:
    hello = json.loads(await socket.recv())
    await socket.send(json.dumps(WELCOME))
    return hello  # type: ignore[no-any-return]


def test_scenes_arrive_and_are_acknowledged() -> None:
    data, heard = packets(states(4)), []

    async def stream(socket: ServerConnection) -> None:
        heard.append(await welcome(socket))
        for packet in data:
            await socket.send(packet)
        while sum(message.get("type") == "ack" for message in heard) < 2:
            heard.append(json.loads(await socket.recv()))

    events = events_from(stream, options=WatchOptions(levels=2))
    assert isinstance(events[0], Welcome)
    assert [event.scene.version for event in events if isinstance(event, NewScene)] == [0, 1, 2, 3]
    assert heard[0]["levels"] == 2
    assert heard[-1]["bytes"] == sum(map(len, data))


def test_a_broken_connection_is_made_again() -> None:
    data = packets(states(2))

    async def fail(socket: ServerConnection) -> None:
        await welcome(socket)
        await socket.send(data[0])
        await socket.close(1011, "tripped")

    async def recover(socket: ServerConnection) -> None:
        assert (await welcome(socket))["start"] == "live"
        for packet in data:
            await socket.send(packet)

    events = events_from(fail, recover)
    assert [e.reason for e in events if isinstance(e, Disconnected)] == ["tripped [1011]"]
    assert [e.scene.version for e in events if isinstance(e, NewScene)] == [0, 0, 1]


def test_a_replay_goes_on_where_it_stopped() -> None:
    data, starts = packets(states(2)), []

    async def replay(socket: ServerConnection) -> None:
        starts.append((await welcome(socket))["start"])
        await socket.send(
            json.dumps({"type": "event", "event": "position", "mode": "replay", "epoch": 3, "version": 0})
        )
        for packet in data:
            await socket.send(packet)
        await socket.close(1001 if len(starts) == 1 else 1000)

    events_from(replay, replay, options=WatchOptions(start=(3, 0)))
    assert starts == [{"epoch": 3, "version": 0}, {"epoch": 3, "version": 1}]


@pytest.mark.parametrize("code", [1009, 4400, 4401, 4403, 4404, 4415])
def test_final_refusals_end_it(code: int) -> None:
    async def refuse(socket: ServerConnection) -> None:
        await socket.close(code, "no")

    with pytest.raises(SessionError, match="no") as caught:
        events_from(refuse)
    assert caught.value.close_code == code


@pytest.mark.parametrize("status", [404, 403, 101])
def test_an_edge_that_refuses_is_left_for_the_server_itself(status: int) -> None:
    """As one that serves other streams, or knows other tokens, or whose past is shorter; others are no addresses."""
    data = packets(states(2))

    async def live(socket: ServerConnection) -> None:
        await welcome(socket)
        for packet in data:
            await socket.send(packet)
        await socket.close(1000)

    async def refuse(socket: ServerConnection) -> None:
        await socket.close(4404, "no such stream")

    def edge_answer(socket: ServerConnection, request: Request) -> Response | None:
        if request.path == "/readyz":
            return socket.respond(HTTPStatus.OK, "ready")
        return None if status == 101 else socket.respond(HTTPStatus(status), "no")

    async def run() -> list[Event]:
        options = {"subprotocols": [SUBPROTOCOL], "compression": None}
        async with serve(refuse, "127.0.0.1", 0, process_request=edge_answer, **options) as edge:  # type: ignore[arg-type]
            place = f"http://127.0.0.1:{edge.sockets[0].getsockname()[1]}"

            def home_answer(socket: ServerConnection, request: Request) -> Response | None:
                named = json.dumps({"edges": ["http://[::::", place]})
                return socket.respond(HTTPStatus.OK, named) if request.path == "/v1/server" else None

            async with serve(live, "127.0.0.1", 0, process_request=home_answer, **options) as home:  # type: ignore[arg-type]
                url = f"ws://127.0.0.1:{home.sockets[0].getsockname()[1]}/v1/streams/main/live"
                async with aclosing(watch(url, WatchOptions(nearest=True), attempts=3)) as events:
                    return [event async for event in events]

    events = asyncio.run(run())
    assert [type(event) for event in events] == [Disconnected, Welcome, NewScene, NewScene]


async def tell(socket: ServerConnection, **fields: object) -> None:
    await socket.send(json.dumps(fields))


def moved(edge: Behaviour, stops: Behaviour) -> list[Event]:
    """What `watch` tells of a server that welcomes as incarnation "a" and `stops`, and of the edge that it names."""

    def answer(socket: ServerConnection, request: Request) -> Response | None:
        return socket.respond(HTTPStatus.OK, "ready") if request.path == "/readyz" else None

    async def run() -> list[Event]:
        options = {"subprotocols": [SUBPROTOCOL], "compression": None}
        async with asyncio.timeout(60), serve(edge, "127.0.0.1", 0, process_request=answer, **options) as other:  # type: ignore[arg-type]
            place = f"http://127.0.0.1:{other.sockets[0].getsockname()[1]}"

            async def begin(socket: ServerConnection) -> None:
                await socket.recv()
                await tell(socket, **{**WELCOME, "incarnation": "a", "edges": [place]})
                await stops(socket)

            async with serve(begin, "127.0.0.1", 0, **options) as home:  # type: ignore[arg-type]
                url = f"ws://127.0.0.1:{home.sockets[0].getsockname()[1]}/v1/streams/main/live"
                async with aclosing(watch(url)) as events:
                    return [event async for event in events]

    events = asyncio.run(run())
    assert not any(isinstance(event, Disconnected) for event in events)
    return events


@pytest.mark.parametrize(("incarnation", "shown"), [("a", [0, 1, 2, 3, 4, 5]), ("b", [0, 1, 2, 3, 1, 2, 3, 4, 5])])
def test_an_edge_that_is_behind_shows_nothing_again(incarnation: str, shown: list[int]) -> None:
    """Unless it has another incarnation of the stream, under which a position is another picture."""
    data, left = packets(states(6)), asyncio.Event()

    async def behind(socket: ServerConnection) -> None:
        await socket.recv()
        await tell(socket, **{**WELCOME, "incarnation": incarnation})
        for packet in data[:2]:
            await socket.send(packet)
        await tell(socket, type="event", event="caught_up")
        left.set()
        for packet in data[2:]:
            await socket.send(packet)
        await socket.close(1000)

    async def stop(socket: ServerConnection) -> None:
        for packet in data[:4]:
            await socket.send(packet)
        await tell(socket, type="event", event="draining")
        await left.wait()
        await socket.close(1001)

    events = moved(behind, stop)
    assert [event.scene.version for event in events if isinstance(event, NewScene)] == shown


@pytest.mark.parametrize(("until", "left_out"), [(6, []), (4, [{"from": 3, "to": 5, "reason": "moved"}])])
def test_an_edge_that_is_ahead_is_taken_where_it_began(until: int, left_out: list[dict[str, object]]) -> None:
    """The server that stops still has what comes before; it is not left until all of that has been shown.

    Where it ends before that, it is said what is left out.
    """
    clip, joined = states(8), asyncio.Event()
    data = packets(clip)
    catch_up = encode_residual(clip[0], difference(clip[0], clip[5]), time_ns=5 * FRAME_NS, profile=0)

    async def ahead(socket: ServerConnection) -> None:
        await socket.recv()
        await tell(socket, **{**WELCOME, "incarnation": "a"})
        for packet in (data[0], catch_up):
            await socket.send(packet)
        await tell(socket, type="event", event="caught_up")
        joined.set()
        for packet in data[6:]:
            await socket.send(packet)
        await socket.close(1000)

    async def stop(socket: ServerConnection) -> None:
        for packet in data[:2]:
            await socket.send(packet)
        await tell(socket, type="event", event="draining")
        await joined.wait()
        for packet in data[2:until]:
            for _ in range(10):  # there and back, so that the viewer knows of the other one meanwhile
                await (await socket.ping())
            await socket.send(packet)
        if left_out:
            await socket.close(1001)
        await socket.wait_closed()

    events = moved(ahead, stop)
    shown = [event.scene.version for event in events if isinstance(event, NewScene)]
    assert shown == [*range(until), *range(max(until, 5), 8)]
    assert [event.fields for event in events if isinstance(event, Notice) and event.name == "skipped"] == left_out


def test_a_server_that_breaks_the_protocol_gets_one_more_chance() -> None:
    closed = []

    async def lie(socket: ServerConnection) -> None:
        await welcome(socket)
        await socket.send(b"SLPK not a packet")
        await socket.wait_closed()
        closed.append(socket.close_code)

    with pytest.raises(SessionError, match="refused"):
        events_from(lie, lie)
    assert closed[0] == 4400


def test_a_server_that_is_full_is_not_taken_for_one_that_does_not_run() -> None:
    async def full(socket: ServerConnection) -> None:
        await socket.close(1013, "the server is full; try again later")

    with pytest.raises(InputError, match=r"reached \(the server is full; try again later \[1013\]\)$"):
        events_from(full)


def test_nobody_there_and_wrong_addresses() -> None:
    async def first(url: str) -> None:
        async with aclosing(watch(url)) as events:
            await anext(events)

    for url in ("ws://127.0.0.1:9/v1", "ws://", "main"):
        with pytest.raises(InputError) as caught:
            asyncio.run(first(url))
        assert url in str(caught.value)


def test_back_off_is_short_four_times_then_doubles_to_a_limit_with_jitter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streamlod.client.connection.watch, "_MIN_DELAY", 0.5)
    for failures, longest in ((0, 0.5), (3, 0.5), (4, 1.0), (6, 4.0), (9, 15.0), (5000, 15.0)):
        delays = [back_off(failures) for _ in range(50)]
        assert longest / 2 <= min(delays) <= max(delays) <= longest
        assert len(set(delays)) > 10


@pytest.mark.parametrize(
    ("given", "address"),
    [
        ("ws://a:1/v1/streams/x/live?t=1", "ws://a:1/v1/streams/x/live?t=1"),
        ("http://a:8000", "ws://a:8000/v1/streams/main/live"),
        ("http://a:8000/?stream=stage%201&pose=3", "ws://a:8000/v1/streams/stage%201/live"),
        ("http://a:8000/v1/streams/b", "ws://a:8000/v1/streams/b/live"),
        ("https://a/hall/v1/streams/b%201/live?x=1", "wss://a/hall/v1/streams/b%201/live"),
        ("https://a/hall/index.html?stream=b", "wss://a/hall/v1/streams/b/live"),
    ],
)
def test_the_pages_address_leads_to_its_stream(given: str, address: str) -> None:
    assert live_address(given) == address


def test_who_gives_a_file_is_told_how_it_is_watched() -> None:
    with pytest.raises(InputError, match="is a file; `streamlod serve --play` it"):
        live_address(__file__)


@pytest.mark.parametrize("given", ["a:8000", "ftp://a/b", ""])
def test_other_addresses_are_refused(given: str) -> None:
    with pytest.raises(InputError, match="is no stream"):
        live_address(given)


@pytest.mark.parametrize("given", ["http://[x/", "ws://a:b/v1/streams/main/live", "http://a:99999", "http://a..b/"])
def test_what_is_no_address_is_refused_in_one_sentence(given: str) -> None:
    with pytest.raises(InputError, match="is no address"):
        live_address(given)
