"""The page in Chromium while its server is away, and when there is one again."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import (
    INSPECT,
    meets,
    shows,
)
from tests.server.ports import held_ports

pytestmark = pytest.mark.browser


def test_reconnects_after_the_server_restarts(page: Any, clip: Clip) -> None:
    """The last picture stays while the server is away, then it goes on."""
    with contextlib.ExitStack() as stack:
        (port,) = stack.enter_context(held_ports(1))
        with serving(create_app(clip, Behaviour(newest=5)), port) as url:
            page.goto(f"{url}/?quality=high")
            shows(page, "s.version === 5")
        shows(page, "s.phase === 'reconnecting'")
        assert page.locator("#card").is_hidden()
        with meets(page, "s.version === 9 && s.phase === 'live'"):
            stack.enter_context(serving(create_app(clip, Behaviour(newest=9, fps=60)), port))
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[9].levels]
    page.complaints.forgive("WebSocket connection to")


def test_real_server_restarted_in_mid_stream(page: Any, clip: Clip, recording: Path) -> None:
    """A server stops while frames arrive, and another takes its place: the page waits, then shows that one's stream."""
    from streamlod.server.pipeline.spec import StreamSpec
    from streamlod.server.settings import Settings
    from tests.server.conftest import running

    with held_ports(1) as (port,):
        with running(Settings(), StreamSpec(play=recording, loop=True), port=port) as server:
            page.goto(f"{server.url}/?quality=high&together=1")
            shows(page, "s.version > 3")
        shows(page, "s.phase === 'reconnecting'")
        assert page.locator("#card").is_hidden()
        with running(Settings(), StreamSpec(play=recording, loop=False), port=port):
            shows(page, "s.version === 39 && s.phase !== 'reconnecting'")
            assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[39].levels]
    page.complaints.forgive("WebSocket connection to")


def test_what_is_asked_for_without_a_connection_counts_once_there_is_one(page: Any, clip: Clip) -> None:
    """A place sought, and a pause, while the server is away."""
    behaviour = Behaviour(newest=30)
    with contextlib.ExitStack() as stack, held_ports(1) as (port,):
        with serving(create_app(clip, behaviour), port) as url:
            page.goto(f"{url}/?quality=high")
            shows(page, "s.version === 30 && s.phase === 'live'")
        shows(page, "s.phase === 'reconnecting'")
        page.evaluate("streamlod.seek(5); streamlod.pause()")
        stack.enter_context(serving(create_app(clip, behaviour), port))
        shows(page, "s.version === 5 && s.phase === 'paused'")
        page.evaluate("streamlod.play()")
        shows(page, "s.version > 20")
        page.goto("about:blank")
    page.complaints.forgive("WebSocket connection to")
