"""The page of all cameras while `streamlod rig` runs, in Chromium."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from streamlod.server.cli.rig import watch
from streamlod.server.settings import Settings
from tests.client.web.test_accessible import AXE, RULES
from tests.client.web.watching import WAIT
from tests.core.data.writers import write_video
from tests.server.ingest.rig import FPS, HEIGHT, WIDTH, burnt, write_definition
from tests.waiting import wait

pytestmark = pytest.mark.browser
SHOWN = "what all cameras see: "
TILES = """() => [...document.querySelectorAll("#cameras li")].map((tile) => ({
  name: tile.querySelector("h2").textContent, text: tile.innerText, bad: tile.matches(".bad"),
  shows: tile.querySelector("img").naturalWidth > 1,
}))"""


def test_all_cameras_are_seen_at_once_and_one_that_ends_is_named(page: Any, tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(90 * FPS)], fps=FPS)
    write_video(tmp_path / "b.mp4", [burnt(number) for number in range(FPS)], fps=FPS)
    rig, said = write_definition(tmp_path, ["a.mp4", "b.mp4"]), list[str]()
    work = threading.Thread(
        target=lambda: watch(rig, None, 15.0, Settings(port=0), said.append, overwrite=False), daemon=True
    )
    work.start()
    (place,) = wait(lambda: [line.removeprefix(SHOWN) for line in said if line.startswith(SHOWN)])
    page.goto(place)
    page.wait_for_function(f"() => ({TILES})().filter(({{ shows }}) => shows).length === 2", **WAIT)
    page.wait_for_function(f"() => ({TILES})()[1].bad && / a second/.test(({TILES})()[0].text)", **WAIT)
    first, second = page.evaluate(TILES)
    assert (first["name"], second["name"]) == ("cam0", "cam1")
    assert f"{WIDTH}\u00d7{HEIGHT}" in first["text"]
    assert not first["bad"]
    assert "it ended" in second["text"]
    assert page.text_content("#status-text") == "1 of 2 cameras film as they should; see cam1"
    before = page.get_attribute("#cameras img", "src")
    page.wait_for_function("(before) => document.querySelector('#cameras img').src !== before", arg=before, **WAIT)
    if AXE.exists():
        page.add_script_tag(path=AXE)
        assert page.evaluate(RULES, None) == []
    work.join(60)
    page.wait_for_function("document.getElementById('status-text').textContent.includes('does not answer')", **WAIT)
    page.complaints.forgive("ERR_")


def test_a_slow_camera_is_named_with_what_to_do(page: Any, tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [burnt(number) for number in range(30 * FPS)], fps=FPS)
    write_video(tmp_path / "b.mp4", [burnt(number) for number in range(30 * FPS // 3)], fps=FPS // 3)
    rig, said = write_definition(tmp_path, ["a.mp4", "b.mp4"], {"quorum": 1}), list[str]()
    work = threading.Thread(
        target=lambda: watch(rig, None, 15.0, Settings(port=0), said.append, overwrite=False), daemon=True
    )
    work.start()
    (place,) = wait(lambda: [line.removeprefix(SHOWN) for line in said if line.startswith(SHOWN)])
    page.goto(place)
    page.wait_for_function(f"() => {{ const [, slow] = ({TILES})(); return slow?.bad; }}", **WAIT)
    first, second = page.evaluate(TILES)
    assert not first["bad"]
    assert "10 a second, but the rig wants 30 pictures: give more light" in second["text"]
    assert page.text_content("#status-text") == "1 of 2 cameras film as they should; see cam1"
    page.complaints.forgive("ERR_")
    work.join(60)
