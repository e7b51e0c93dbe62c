"""The page and edges: it watches at the nearest that answers, and goes on at another when its own stops."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.client.web.watching import WAIT, shows
from tests.server.conftest import Clip, Running, make_clip, running
from tests.server.ports import held_ports
from tests.waiting import wait

pytestmark = [pytest.mark.browser, pytest.mark.cluster]

SMALL = {"width": 320, "height": 240}  # to draw; a busy machine shows enough pictures of it
# The longest time between two versions [ms], how many were seen, and all phases, from here on. Time in which the page
# does not run is not counted: versions that come meanwhile are not seen.
WATCH = """() => {
  let version = 0, last = performance.now(), silent = 0;
  window.gap = window.seen = 0;
  setInterval(() => {
    const state = streamlod.state, now = performance.now();
    window.seen += state.version !== version;
    silent = state.version === version ? silent + Math.min(now - last, 50) : 0;
    [version, last] = [state.version, now];
    window.gap = Math.max(window.gap, silent);
    (window.phases ??= new Set()).add(state.phase);
  }, 10);
}"""


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return make_clip(tmp_path_factory.mktemp("clip") / "scene.slod", 1000, key_every=50)


def pages_at(server: Running) -> int:
    return sum(session.client.startswith("streamlod-web") for session in list(server.registry.sessions))


def goes_to_an_edge(page: Any, url: str, is_there: Callable[[], object]) -> None:
    """Open the page, again where it stays: it gives edges two seconds to answer, which a busy machine may exceed."""
    limit = time.monotonic() + 60
    while time.monotonic() < limit and not is_there():
        page.goto(url)
        with suppress(AssertionError):
            wait(is_there)
    assert is_there()


def test_the_page_watches_at_an_edge_and_leaves_it_when_it_stops(chromium: Any, long_clip: Clip) -> None:
    with ExitStack() as stack:
        ports = stack.enter_context(held_ports(3))
        addresses = [f"http://127.0.0.1:{port}" for port in ports]
        known = Settings(edges=tuple(addresses[1:]))
        origin = stack.enter_context(running(known, StreamSpec(play=long_clip.path), port=ports[0]))
        origin.registry.streams["main"].source = "cameras"  # the page goes to edges for what is live
        of_origin = EdgeSettings(origin=origin.url, poll_seconds=0.1, linger_seconds=0.2)
        edge = Settings(edge=of_origin, origins=(origin.url,))
        stops = [stack.enter_context(ExitStack()) for _ in range(2)]
        edges = [stop.enter_context(running(edge, port=port)) for stop, port in zip(stops, ports[1:], strict=True)]
        for each in edges:
            wait(lambda each=each: each.registry.edges and not each.registry.unready)
        page = stack.enter_context(chromium.new_context(viewport=SMALL)).new_page()
        goes_to_an_edge(page, f"{origin.url}/?stream=main&quality=low&sway=0", lambda: sum(map(pages_at, edges)) == 1)
        wait(lambda: not pages_at(origin), 60)
        shows(page, "s.version > 0")

        page.evaluate(WATCH)
        at = 0 if pages_at(edges[0]) else 1
        stops[at].close()  # as after SIGTERM
        wait(lambda: pages_at(edges[1 - at]) == 1, 60)
        page.wait_for_function("(seen) => window.seen > seen + 25", arg=page.evaluate("window.seen"), **WAIT)
        assert page.evaluate("window.gap") < 4000  # ms; the browser draws on a busy CPU
        assert page.evaluate("!window.phases.has('reconnecting')")  # it went before it was sent away

        stops[1 - at].close()  # no edge is left: back to where it came from
        wait(lambda: pages_at(origin) == 1, 60)
        shows(page, "!['reconnecting', 'connecting'].includes(s.phase)")


def test_the_page_goes_back_where_an_edge_refuses_what_its_origin_serves(chromium: Any, long_clip: Clip) -> None:
    with ExitStack() as stack:
        ports = stack.enter_context(held_ports(2))
        known = Settings(edges=(f"http://127.0.0.1:{ports[1]}",))
        origin = stack.enter_context(running(known, StreamSpec(play=long_clip.path), port=ports[0]))
        origin.registry.streams["main"].source = "cameras"  # the page goes to edges for what is live
        of_another = EdgeSettings(origin=origin.url, streams=("another",), poll_seconds=0.1)
        edge = stack.enter_context(running(Settings(edge=of_another, origins=(origin.url,)), port=ports[1]))
        wait(lambda: not edge.registry.unready)
        page = stack.enter_context(chromium.new_context(viewport=SMALL)).new_page()
        goes_to_an_edge(
            page, f"{origin.url}/?stream=main&quality=low&sway=0", lambda: edge.registry.turned_away["4404"]
        )
        wait(lambda: pages_at(origin) == 1, 60)
        shows(page, "s.version > 0 && !['missing', 'reconnecting', 'connecting'].includes(s.phase)")
        page.evaluate(WATCH)
        page.wait_for_function("window.seen > 25", **WAIT)
        assert pages_at(origin) == 1  # and stays there
        assert edge.registry.turned_away["4404"] == 1
