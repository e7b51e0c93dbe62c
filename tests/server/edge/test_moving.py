"""Viewers that go on at another edge: when theirs is stopped, and when it is killed."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, aclosing
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from streamlod.client.connection.edges import edges_of, nearest
from streamlod.client.connection.link import WatchOptions
from streamlod.client.connection.watch import watch
from streamlod.client.events import Disconnected, NewScene, Notice, Welcome
from tests.server.conftest import Clip
from tests.server.edge.processes import Node, begin, listening
from tests.server.ports import held_ports
from tests.waiting import wait

pytestmark = pytest.mark.cluster


@dataclass(slots=True)
class Seen:
    """What a viewer was told: the version of each scene, those after which some were left out, and the rest."""

    versions: list[int] = field(default_factory=list)
    welcomes: list[Welcome] = field(default_factory=list)
    breaks: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    skipped: set[int] = field(default_factory=set)


def look(url: str, act: Callable[[], None], after: int, more: int, options: WatchOptions) -> Seen:
    """Watch; call `act` after so many scenes, and watch for so many more that another server has sent."""

    async def run() -> Seen:
        seen, acted, end = Seen(), False, 0
        async with asyncio.timeout(120), aclosing(watch(url, options)) as events:
            async for event in events:
                match event:
                    case NewScene():
                        seen.versions.append(event.scene.version)
                    case Welcome():
                        seen.welcomes.append(event)
                        end = len(seen.versions) + more
                    case Disconnected():
                        seen.breaks.append(event.reason)
                    case Notice():
                        seen.notices.append(event.name)
                        if event.name == "skipped":
                            seen.skipped.add(event.fields["from"])
                if len(seen.versions) >= after and not acted:
                    acted = True
                    await asyncio.to_thread(act)
                elif acted and len(seen.welcomes) > 1 and len(seen.versions) >= end:
                    return seen
        raise AssertionError(seen)

    return asyncio.run(run())


@pytest.fixture(scope="module")
def nodes(long_clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Node, Node, Node]]:
    """An origin that knows two edges, and the edges, which hear of each other from it."""
    folder: Path = tmp_path_factory.mktemp("edges")
    config, patient = folder / "origin.toml", folder / "edge.toml"
    patient.write_text("drain_seconds = 10\n")  # a quarter of it for viewers to be at another edge
    with ExitStack() as stack:
        origin, *edges = stack.enter_context(held_ports(3))
        config.write_text(f'edges = ["http://127.0.0.1:{edges[0]}", "http://127.0.0.1:{edges[1]}"]\n')
        started = [begin(folder, "serve", "--play", long_clip.path, "--config", config, port=origin)]
        edge = ("edge", "--origin", f"http://127.0.0.1:{origin}", "--config", patient)
        started += [begin(folder, *edge, port=port) for port in edges]
        for process, _ in started:
            stack.callback(process.wait)
            stack.callback(process.kill)
        found = tuple(listening(each) for each in started)
        for each in found:
            wait(lambda each=each: each.get("/readyz").status_code == 200)
            wait(lambda each=each: each.get("/v1/server").json()["edges"])
        yield found  # type: ignore[misc]


def live(server: Node) -> str:
    return f"ws://127.0.0.1:{server.port}/v1/streams/main/live"


def test_origin_and_edges_name_the_edges(nodes: tuple[Node, Node, Node]) -> None:
    edges = [edge.url for edge in nodes[1:]]
    for each in nodes:
        assert each.get("/v1/streams/main/manifest").json()["edges"] == edges
        with each.viewing() as viewer:
            assert viewer.hello().welcome["edges"] == edges
    assert asyncio.run(edges_of(live(nodes[0]), None)) == tuple(edges)


def test_a_viewer_takes_the_edge_that_answers(nodes: tuple[Node, Node, Node], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three, one does not exist and one never answers."""
    path = "/v1/streams/main/live"
    with socket.create_server(("127.0.0.1", 0)) as silent, held_ports(1) as (missing,):
        lost = [f"ws://127.0.0.1:{port}{path}" for port in (silent.getsockname()[1], missing)]
        assert asyncio.run(nearest(lost)) is None
        monkeypatch.setattr("streamlod.client.connection.edges._ANSWER_SECONDS", 20.0)
        assert asyncio.run(nearest([*lost, live(nodes[2])])) == live(nodes[2])


def test_an_edge_that_stops_is_left_without_a_gap(nodes: tuple[Node, Node, Node]) -> None:
    """The other one's picture is there before the connection ends, and no version is shown twice or left out.

    But for those that a server leaves out because this machine is too busy to take them, which it says.
    """
    stopped = nodes[1]

    def stop() -> None:
        stopped.process.send_signal(signal.SIGTERM)

    with nodes[2].viewing() as warm:  # as where others watch; a cold edge takes longer, which is no gap either
        warm.hello().until("caught_up")
        seen = look(live(stopped), stop, 100, 100, WatchOptions())
    assert "draining" in seen.notices
    assert seen.breaks == []
    assert len(seen.welcomes) == 2
    shown = zip(seen.versions[60:], seen.versions[61:], strict=False)
    odd = {pair for pair in shown if pair[1] - pair[0] not in {0, 1} and pair[0] not in seen.skipped}
    assert odd <= {(399, 0)}, seen.skipped  # versions stay where a keyframe comes; after the last the clip begins again
    assert stopped.process.wait(60) == 0


def test_a_killed_edge_is_replaced_by_the_other(
    nodes: tuple[Node, Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was chosen as the nearest of the edges that the origin names, where the first one has gone."""
    monkeypatch.setattr("streamlod.client.connection.edges._ANSWER_SECONDS", 20.0)
    killed = nodes[2]
    nodes[1].kill()  # so that the nearest is the one that is killed
    seen = look(live(nodes[0]), killed.kill, 50, 20, WatchOptions(nearest=True))
    assert len(seen.breaks) == 1  # so it was not at the origin
