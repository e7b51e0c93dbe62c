"""The page of a server that a proxy shows under a path, `https://host/stage/`."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.attack.test_proxies import proxy
from tests.client.web.miniserver import Clip
from tests.client.web.watching import INSPECT, shows
from tests.server.conftest import running


@pytest.mark.browser
def test_everything_works_under_a_path_of_a_proxy(page: Any, clip: Clip, recording: Path, tmp_path: Path) -> None:
    """Live, seeking, the recording as a file, the list of streams: nothing is asked for outside the path."""
    asked: list[str] = []
    faults: list[tuple[int, str]] = []
    page.on("request", lambda request: asked.append(urlsplit(request.url).path))
    page.on("websocket", lambda socket: asked.append(urlsplit(socket.url).path))
    page.on("response", lambda answer: faults.append((answer.status, answer.url)) if answer.status >= 400 else None)
    spec = StreamSpec(play=recording, loop=False)
    with running(Settings(), spec) as server, proxy("nginx", tmp_path, server.port, "/stage") as port:
        base = f"http://127.0.0.1:{port}/stage/"
        page.goto(f"{base}?quality=high&together=1")
        shows(page, "s.version === 39")
        page.evaluate("streamlod.pause()")
        shows(page, "s.mode === 'paused'")
        page.evaluate("streamlod.seek(11)")
        shows(page, "s.version === 11 && s.phase === 'paused'")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[11].levels]
        page.goto(f"{base}?quality=high&src=v1/streams/main/bitstream")
        shows(page, "s.version === 39 && s.phase === 'ended'")
    assert {"/stage/v1/streams", "/stage/v1/streams/main/live", "/stage/v1/streams/main/bitstream"} <= set(asked)
    assert not [path for path in asked if path and not path.startswith("/stage/") and "/" in path[1:]]
    assert faults == []


def test_previews_of_links_lead_to_the_path(recording: Path, tmp_path: Path) -> None:
    with (
        running(Settings(), StreamSpec(play=recording)) as server,
        proxy("nginx", tmp_path, server.port, "/s/2") as port,
    ):
        base = f"http://127.0.0.1:{port}/s/2/"
        with httpx.Client(trust_env=False) as client:
            head = client.get(f"{base}?stream=main&camera=cam01")
            told = client.get(head.headers["link"].split(">")[0][1:]).raise_for_status().json()
            elsewhere = client.get(f"{base}oembed", params={"url": f"http://127.0.0.1:{port}/?stream=main"})
    for text in (f'og:url" content="{base}?stream=main', f'og:image" content="{base}v1/streams/main/poster.jpg'):
        assert text in head.text
    assert f'src="{base}?stream=main' in told["html"]
    assert told["provider_url"] == base
    assert elsewhere.status_code == 404


@pytest.mark.parametrize("prefix", ["//evil.example", "/a/../b", "/a b", "javascript:x", "/<b>", "a", "/" * 9])
def test_a_prefix_that_is_no_path_is_ignored(recording: Path, prefix: str) -> None:
    with running(Settings(), StreamSpec(play=recording)) as server, server.client() as client:
        told = client.get("/?stream=main", headers={"X-Forwarded-Prefix": prefix})
        assert f'og:url" content="{server.url}/?stream=main"' in told.text
