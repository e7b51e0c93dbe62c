"""Files that the page plays in Chromium without a server of streams: whole, cut and damaged ones."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from streamlod.codec.container import SlodReader
from tests.client.web.miniserver import WEB, Behaviour, Clip, create_app, serving
from tests.client.web.simple_server import simple_server
from tests.client.web.watching import (
    INSPECT,
    WAIT,
    shows,
)

pytestmark = pytest.mark.browser


def test_recording_plays_without_a_server(page: Any, clip: Clip, recording: Path) -> None:
    """A .slod file over Range requests: plays, steps back, ends; the state is exact."""
    with serving(create_app(clip, Behaviour(), recording.parent)) as url:
        page.goto(f"{url}/?src=files/clip.slod&quality=high")
        shows(page, "s.version === 39 && s.phase === 'ended'")
        page.evaluate("streamlod.seek(11)")
        shows(page, "s.version === 11 && s.phase === 'paused'")
        page.keyboard.press(",")
        shows(page, "s.version === 10")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[10].levels]
        page.evaluate("streamlod.loop(true); streamlod.play()")
        shows(page, "s.version < 10 && s.phase === 'replay'")


def test_nobody_waits_where_nothing_was_filmed(page: Any, clip: Clip, tmp_path: Path) -> None:
    """Ten minutes in which the phones were away; the picture before them stays for ten seconds."""
    replace(clip, states=clip.states[:2], frame_ns=600 * 10**9, _made={}).write(tmp_path / "clip.slod")
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?src=files/clip.slod&quality=high")
        shows(page, "s.version === 0")
        shows(page, "s.version === 1")


def test_recording_from_a_server_that_knows_no_ranges(page: Any, clip: Clip, recording: Path, tmp_path: Path) -> None:
    """The page and a file in one folder of the simplest server there is; speed and loop are offered."""
    shutil.copytree(WEB, tmp_path / "site")
    shutil.copy(recording, tmp_path / "site")
    with simple_server(tmp_path / "site") as url:
        page.goto(f"{url}/?src=clip.slod&quality=high")
        shows(page, "s.version === 39 && s.phase === 'ended'")
        page.evaluate("streamlod.seek(17)")
        shows(page, "s.version === 17 && s.phase === 'paused'")
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[17].levels]
        assert not page.locator("#t-live").is_visible()
        page.set_viewport_size({"width": 800, "height": 400})
        page.mouse.move(400, 100)  # the controls may have hidden before it was paused
        page.click("#t-speed")
        assert page.locator("#t-speed").inner_text() == "2\u00d7"
        page.click("#t-loop")
        page.evaluate(
            "window.shown = []; streamlod.on('picture', ({ version }) => shown.push(version)); streamlod.play()"
        )
        page.wait_for_function("shown.findIndex((v, i) => i && v < shown[i - 1]) > 0", **WAIT)


def test_a_file_plays_what_is_whole(page: Any, clip: Clip, recording: Path, tmp_path: Path) -> None:
    """Cut in the middle it plays up to there; with a damaged packet it ends before that. Both are said."""
    whole = recording.read_bytes()
    with SlodReader(recording) as reader:
        places = [entry.offset for entry in reader.entries]
    (tmp_path / "cut.slod").write_bytes(whole[: places[6] + 40])  # of version 6 the begin only
    damaged = bytearray(whole)
    damaged[places[6] + 60] ^= 0xFF
    (tmp_path / "damaged.slod").write_bytes(bytes(damaged))
    with serving(create_app(clip, Behaviour(), tmp_path)) as url:
        page.goto(f"{url}/?src=files/cut.slod&quality=high")
        shows(page, "s.phase === 'ended' && s.version === 5 && s.window.newest.version === 5")
        page.locator("#status-text", has_text="a part of the file is damaged").wait_for(**WAIT)
        page.goto(f"{url}/?src=files/damaged.slod&quality=high")
        shows(page, "s.phase === 'ended' && s.version === 5 && s.window.newest.version === 5")
        page.locator("#status-text", has_text="a part of the file is damaged").wait_for(**WAIT)
        assert page.title().startswith("damaged.slod")
        page.evaluate("streamlod.seek(3)")  # at once after the end: still there
        shows(page, "s.version >= 3")
