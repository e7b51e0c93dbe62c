"""The page over refresh keyframes of 300 KB and more from the real server, with its decoder and as a thin viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Settings
from tests.client.web.watching import WAIT
from tests.server.conftest import running
from tests.server.large_clip import make_large_clip

pytestmark = pytest.mark.browser
COUNT = """() => {
  window.seen = new Set();  // groups of pictures that were shown
  setInterval(() => {
    const { position, version } = streamlod.state;
    if (position) window.seen.add(`${position.epoch}/${Math.floor(version / 3)}`);
  }, 20);
}"""


@pytest.mark.parametrize("thin", [False, True])
def test_the_page_follows_over_several_of_them_on_one_connection(page: Any, tmp_path: Path, thin: bool) -> None:
    clip = make_large_clip(tmp_path)
    sockets: list[Any] = []
    page.on("websocket", lambda socket: sockets.append(socket))  # noqa: PLW0108 - Playwright sets attributes on it
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        page.goto(f"{server.url}/?together=1" + ("&thin=1" if thin else ""))
        page.wait_for_function("window.streamlod?.state?.version > 0", **WAIT)
        page.evaluate(COUNT)
        page.wait_for_function("window.seen.size > 4", **WAIT)
        assert len(sockets) == 1
