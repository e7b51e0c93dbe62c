"""Watching together: who may present, what followers are told, and what hostile viewers can't do."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Iterator
from contextlib import aclosing, contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.presented import Presented, presented
from streamlod.client.connection.presenting import Presenter
from streamlod.client.connection.watch import watch
from streamlod.client.events import Event, Notice
from streamlod.core.camera import look_at, pinhole
from streamlod.core.errors import InputError
from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Limits, Settings
from tests.server.conftest import Clip, Running, Viewer, running, viewing

VIEW: dict[str, Any] = {
    "position": [1.0, 2.0, -3.0], "rotation": [1.0, 0, 0, 0, 1, 0, 0, 0, 1], "distance": 4.0, "focal": 1.2,
    "stretch": 1.0, "shift": [0.0, 0.01],
}  # fmt: skip
LIVE = {"mode": "live"}


@pytest.fixture(scope="module")
def server(slow_clip: Clip) -> Iterator[Running]:
    with running(Settings(together=True), StreamSpec(play=slow_clip.path, loop=True)) as server:
        yield server


@contextmanager
def joined(server: Running, **options: Any) -> Iterator[Viewer]:
    with viewing(server, **options) as viewer:
        yield viewer.hello()


def present(viewer: Viewer, at: dict[str, Any] = LIVE, **changes: Any) -> None:
    viewer.send(type="present", view=VIEW | changes, at=at)


def shown_to(viewer: Viewer, **wanted: Any) -> dict[str, Any]:
    """The first presenter event from now on in which these fields are so."""
    while True:
        found = viewer.until("presenter")
        if all(found.get(name) == value for name, value in wanted.items()):
            return found


def test_followers_see_what_is_presented_and_others_only_who_presents(server: Running) -> None:
    with joined(server) as presenter, joined(server) as follower, joined(server) as other:
        assert presenter.welcome["together"] == {"by": None, "may_present": True}
        follower.send(type="follow", on=True)
        paused = {"mode": "paused", "epoch": 1, "version": 7}
        present(presenter, paused)
        by = presenter.welcome["session"]
        told = {"type": "event", "event": "presenter", "by": by}
        assert shown_to(follower, by=by) == told | {"view": VIEW, "at": paused}
        assert shown_to(other, by=by) == told
        present(presenter, focal=2.0)
        assert shown_to(follower, at=LIVE)["view"]["focal"] == 2.0
        with joined(server) as late:
            assert late.welcome["together"]["by"] == by
            late.send(type="follow", on=True)
            assert shown_to(late, by=by)["view"]["focal"] == 2.0
        follower.send(type="follow", on=False)
        presenter.send(type="present", view=None)
        for viewer in (follower, other):
            assert shown_to(viewer, by=None) == {"type": "event", "event": "presenter", "by": None}


def test_a_presenter_that_goes_presents_no_more_and_a_second_one_is_told_who_does(server: Running) -> None:
    with joined(server) as follower:
        follower.send(type="follow", on=True)
        with joined(server) as first, joined(server) as second:
            present(first)
            by = first.welcome["session"]
            shown_to(follower, by=by)
            present(second, focal=9.0)
            assert shown_to(second, by=by)["by"] == by
            second.send(type="present", view=None)  # of somebody else
            present(first, focal=3.0)
            assert shown_to(follower, by=by)["view"]["focal"] == 3.0
        assert shown_to(follower, by=None)["by"] is None
        assert all(event.get("view", VIEW)["focal"] != 9.0 for event in follower.named("presenter"))


def test_views_that_come_fast_are_told_ten_times_a_second_the_newest_last(server: Running) -> None:
    with joined(server) as presenter, joined(server) as follower:
        follower.send(type="follow", on=True)
        begin = time.monotonic()
        for number in range(1, 41):
            present(presenter, distance=float(number))
        found = shown_to(follower)
        while found["view"]["distance"] != 40.0:
            found = shown_to(follower)
        spent = time.monotonic() - begin
        assert len(follower.named("presenter")) <= 2 + 10 * spent


def closed_with(viewer: Viewer) -> int | None:
    with pytest.raises(ConnectionClosed) as caught:
        viewer.until("the end")
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code


@pytest.mark.parametrize(
    "message",
    [
        {"type": "follow"},
        {"type": "follow", "on": 1},
        {"type": "present", "view": VIEW},
        {"type": "present", "view": [], "at": LIVE},
        {"type": "present", "view": {}, "at": LIVE},
        {"type": "present", "view": VIEW | {"position": [1, 2]}, "at": LIVE},
        {"type": "present", "view": VIEW | {"position": [1e300, 0, 0]}, "at": LIVE},
        {"type": "present", "view": VIEW | {"position": ["<b>", 0, 0]}, "at": LIVE},
        {"type": "present", "view": VIEW | {"rotation": [0.5] * 9}, "at": LIVE},
        {"type": "present", "view": VIEW | {"rotation": [-1, 0, 0, 0, 1, 0, 0, 0, 1]}, "at": LIVE},
        {"type": "present", "view": VIEW | {"focal": 0}, "at": LIVE},
        {"type": "present", "view": VIEW | {"distance": True}, "at": LIVE},
        {"type": "present", "view": VIEW, "at": {"mode": "backwards"}},
        {"type": "present", "view": VIEW, "at": {"mode": "paused", "epoch": 1}},
        {"type": "present", "view": VIEW, "at": {"mode": "paused", "epoch": 2**32, "version": 0}},
        {"type": "present", "view": VIEW, "at": {"mode": ["live"]}},
    ],
)
def test_malformed_messages_end_the_connection_and_reach_nobody(server: Running, message: dict[str, Any]) -> None:
    with joined(server) as hostile:
        hostile.send(**message)
        assert closed_with(hostile) == 4400
    assert server.registry.streams["main"].together.by is None


def test_what_is_not_known_is_not_passed_on_and_a_flood_is_cut_off(slow_clip: Clip) -> None:
    settings = Settings(together=True, limits=Limits(messages_per_second=20))
    with running(settings, StreamSpec(play=slow_clip.path, loop=True)) as server, joined(server) as follower:
        follower.send(type="follow", on=True)
        with joined(server) as hostile:
            hostile.send(type="present", view=VIEW | {"script": "x" * 2000}, at=LIVE | {"more": 1})
            found = shown_to(follower, by=hostile.welcome["session"])
            assert (found["view"], found["at"]) == (VIEW, LIVE)
            with contextlib.suppress(ConnectionClosed):
                for _ in range(5000):
                    present(hostile)
            assert closed_with(hostile) == 4429
        assert shown_to(follower, by=None)["by"] is None


@pytest.mark.long
def test_nobody_presents_where_it_is_not_offered_or_without_the_right(slow_clip: Clip, tmp_path: Path) -> None:
    with running(Settings(), StreamSpec(play=slow_clip.path, loop=True)) as plain, joined(plain) as viewer:
        assert viewer.welcome["together"] is None
        present(viewer)
        assert closed_with(viewer) == 4403
    entries = [
        {"name": name, "sha256": hash_token(name), "rights": rights, "streams": "main"}
        for name, rights in {"viewer": ["read"], "speaker": ["read", "present"]}.items()
    ]
    (tmp_path / "tokens.json").write_text(json.dumps(entries))
    settings = Settings(together=True, tokens=tmp_path / "tokens.json")
    with running(settings, StreamSpec(play=slow_clip.path, loop=True)) as server:
        tokens = {name: {"additional_headers": {"Authorization": f"Bearer {name}"}} for name in ("viewer", "speaker")}
        with joined(server, **tokens["viewer"]) as viewer, joined(server, **tokens["speaker"]) as speaker:
            assert [each.welcome["together"]["may_present"] for each in (viewer, speaker)] == [False, True]
            viewer.send(type="follow", on=True)
            present(speaker)
            shown_to(viewer, by=speaker.welcome["session"])
            (tmp_path / "tokens.json").write_text(json.dumps([entries[0], entries[1] | {"rights": ["read"]}]))
            assert shown_to(viewer, by=None)["by"] is None  # the right was withdrawn; it may still watch
            present(viewer)
            assert closed_with(viewer) == 4403


@contextmanager
def edge_of(server: Running) -> Iterator[Running]:
    """An edge that has the stream."""
    settings = Settings(edge=EdgeSettings(origin=server.url, linger_seconds=0), together=True)
    with running(settings) as edge:
        edge.wait(lambda stream: stream.get("id") == "main")
        yield edge


def test_an_edge_passes_on_who_presents_at_its_origin(server: Running) -> None:
    with edge_of(server) as edge, joined(edge) as follower, joined(server) as presenter:
        follower.send(type="follow", on=True)
        follower.next_packet()
        present(presenter)
        assert shown_to(follower, by=presenter.welcome["session"])["view"] == VIEW
        present(follower)  # in vain
        presenter.send(type="present", view=None)
        assert shown_to(follower, by=None)["by"] is None


def test_who_presents_at_an_edge_is_followed_everywhere(server: Running) -> None:
    """At the origin, at this edge and at another one; until it goes, and one at a time."""
    with (
        edge_of(server) as edge,
        edge_of(server) as far,
        joined(server) as at_origin,
        joined(far) as at_far,
        joined(edge) as beside,
    ):
        for viewer in (at_origin, at_far, beside):
            viewer.send(type="follow", on=True)
        with joined(edge) as presenter:
            shown_to(beside, may_present=True)
            present(presenter)
            shown_to(beside, by=presenter.welcome["session"], view=VIEW)
            there = shown_to(at_origin, view=VIEW)["by"]
            assert shown_to(at_far, view=VIEW)["by"] == there
            present(beside, focal=9.0)
            assert shown_to(beside)["by"] == presenter.welcome["session"]
            present(at_origin, focal=9.0)
            assert shown_to(at_origin)["by"] == there
            for focal in (2.0, 3.0):
                present(presenter, focal=focal)
            assert shown_to(at_far, by=there)["view"]["focal"] in (2.0, 3.0)
        for viewer in (at_origin, at_far, beside):
            assert shown_to(viewer, by=None)["by"] is None
        assert all(event.get("view", VIEW)["focal"] != 9.0 for event in at_origin.named("presenter"))
        present(beside)
        shown_to(beside, by=beside.welcome["session"])


@pytest.mark.long
def test_an_edge_whose_right_is_withdrawn_presents_no_more_and_stays_connected(
    slow_clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def allow(*rights: str) -> None:
        entry = {"name": "edge", "sha256": hash_token("edge"), "rights": rights, "streams": "*"}
        (tmp_path / "tokens.json").write_text(json.dumps([entry]))

    monkeypatch.setenv("STREAMLOD_TOKEN", "edge")
    allow("read", "present")
    settings = Settings(together=True, tokens=tmp_path / "tokens.json")
    header = {"Authorization": "Bearer edge"}
    with (
        running(settings, StreamSpec(play=slow_clip.path, loop=True)) as origin,
        edge_of(origin) as edge,
        joined(edge) as viewer,
        viewing(origin, additional_headers=header) as relay,
    ):
        relay.hello(relay=True)
        shown_to(viewer, may_present=True)
        present(viewer)
        shown_to(viewer, by=viewer.welcome["session"])
        allow("read")
        for late in (viewer, relay):
            shown_to(late, by=None)
            present(late)  # as who had not heard of it would
            assert shown_to(late)["by"] is None
            late.next_packet()
        assert edge.registry.streams["main"].restarts == 0


def test_a_program_in_python_follows(server: Running) -> None:
    found: list[Presented] = []

    async def follow() -> None:
        address = f"ws://127.0.0.1:{server.port}/v1/streams/main/live"
        async with aclosing(watch(address, WatchOptions(follows=True))) as events:
            async for event in events:
                if isinstance(event, Notice) and event.name == "presenter" and event.fields["by"] is not None:
                    found.append(cast(Presented, presented(event, (640, 480))))
                    return

    with joined(server) as presenter:
        present(presenter, {"mode": "paused", "epoch": 1, "version": 3}, focal=1.5)
        asyncio.run(follow())
    (shown,) = found
    assert (shown.by, shown.mode, shown.position) == (presenter.welcome["session"], "paused", (1, 3))
    assert shown.camera.centre.tolist() == VIEW["position"]
    assert shown.camera.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() == [720, 720, 320, 244.8]


def test_a_program_in_python_presents(server: Running) -> None:
    """What it shows is what another program sees, until it stops."""
    address = f"ws://127.0.0.1:{server.port}/v1/streams/main/live"
    camera = pinhole("tripod", (700, 720), (330, 244), (640, 480), look_at((1, 2, -3), (0, 0, 0), (0, -1, 0)))

    async def play() -> list[Presented | None]:
        presenter, found = Presenter(), list[Presented | None]()
        async with aclosing(watch(address, WatchOptions(presents=presenter))) as speaking:
            await anext(speaking)
            speech = asyncio.create_task(_listen(speaking))
            async with aclosing(watch(address, WatchOptions(follows=True))) as events:
                presenter.show(camera, 4.0, at=(1, 3))
                async for event in events:
                    if isinstance(event, Notice) and event.name == "presenter":
                        found.append(presented(event, (640, 480)))
                        if found[-1] is None:
                            break
                        presenter.stop()
            speech.cancel()
            await asyncio.wait([speech])
        return found

    *shown, end = asyncio.run(play())
    assert end is None
    assert shown[-1] is not None
    assert (shown[-1].mode, shown[-1].position) == ("paused", (1, 3))
    np.testing.assert_allclose(shown[-1].camera.world_to_camera, camera.world_to_camera, atol=1e-12)
    np.testing.assert_allclose(shown[-1].camera.intrinsics, camera.intrinsics, atol=1e-9)


async def _listen(events: AsyncGenerator[Event, None]) -> None:
    async for _ in events:
        pass


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"view": VIEW, "at": None}, "neither live"),
        ({"view": VIEW | {"position": [1, 2]}, "at": LIVE}, "without 3 numbers"),
        ({"view": VIEW | {"position": [float("inf"), 0, 0]}, "at": LIVE}, "out of range"),
        ({"view": VIEW | {"rotation": [2.0] * 9}, "at": LIVE}, "rotation"),
        ({"view": VIEW | {"focal": -1}, "at": LIVE}, "focal"),
    ],
)
def test_a_program_refuses_what_a_lying_server_shows(fields: dict[str, Any], fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        presented(Notice("presenter", {"by": "x", **fields}), (640, 480))
    assert presented(Notice("presenter", {"by": None}), (640, 480)) is None
