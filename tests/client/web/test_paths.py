"""Viewpoints, camera paths and films of them; files that are dropped; another background."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.client.web.miniserver import Behaviour, Clip, create_app, serving
from tests.client.web.watching import WAIT, eventually, picture, shows

pytestmark = pytest.mark.browser

POSITION = "streamlod.state.camera.split(',').slice(0, 3).map(Number)"
DROP = """async (address) => {
  const bytes = await (await fetch(address)).arrayBuffer(), transfer = new DataTransfer();
  transfer.items.add(new File([bytes], address.split("/").pop()));
  for (const type of ["dragover", "drop"]) {
    const event = new DragEvent(type, { bubbles: true, cancelable: true, dataTransfer: transfer });
    if (document.body.dispatchEvent(event)) throw new Error(`the browser would leave the page: ${type}`);
  }
}"""


@pytest.mark.timeout(400)
def test_a_path_is_made_played_linked_saved_and_filmed(page: Any, clip: Clip, tmp_path: Path) -> None:
    """Two viewpoints; the address brings them back; playing ends at the second; the film has the size asked for."""
    with serving(create_app(clip, Behaviour(newest=3))) as url:
        page.set_viewport_size({"width": 640, "height": 480})
        page.goto(f"{url}/?quality=high&sway=0")
        shows(page, "s.version === 3")
        page.evaluate("streamlod.setCamera(0)")
        first = page.evaluate(POSITION)
        page.keyboard.press("b")
        page.locator("#path-menu >> text=Add this view").click(**WAIT)
        page.evaluate("streamlod.setCamera(4)")
        second = page.evaluate(POSITION)
        page.locator("#path-menu >> text=Add this view").click(**WAIT)
        page.fill("[aria-label='Name of viewpoint 2']", "The end~_é")
        page.fill("[aria-label='Time of viewpoint 2, seconds']", "1")
        page.fill("[aria-label='Name of the path']", "Across")
        page.keyboard.press("Tab")
        page.locator("#path-menu >> text=/Play/").wait_for(**WAIT)
        page.goto(page.url)  # the address has it all
        shows(page, "s.version === 3")
        page.locator("#b-path").click(**WAIT)
        assert page.input_value("[aria-label='Name of viewpoint 2']", **WAIT) == "The end~_é"
        assert page.input_value("[aria-label='Name of the path']") == "Across"
        page.locator("[aria-label='Go to viewpoint 1']").click(**WAIT)
        eventually(lambda: np.testing.assert_allclose(page.evaluate(POSITION), first, atol=1e-3))
        page.locator("#path-menu >> text=/Play/").click(**WAIT)
        eventually(lambda: np.testing.assert_allclose(page.evaluate(POSITION), second, atol=1e-3))
        with page.expect_download(**WAIT) as saved:
            page.locator("#path-menu >> text=Save the path").click(**WAIT)
        told = json.loads(Path(saved.value.path()).read_text())
        assert saved.value.suggested_filename == "Across.json"
        assert [key["seconds"] for key in told["keys"]] == [0, 1]
        _film(page, tmp_path)
        shows(page, "s.phase !== 'paused'")
        page.wait_for_function("document.getElementById('canvas').width === 640", **WAIT)  # with the next frame drawn


def _film(page: Any, folder: Path) -> None:
    """A film of one second, 1280 pixels wide."""
    with page.expect_download(timeout=300_000) as saved:
        page.locator("#path-menu >> text=Save a film").click(**WAIT)
    name = saved.value.suggested_filename
    assert name in ("Across.webm", "Across.mp4")
    saved.value.save_as(folder / name)
    if shutil.which("ffprobe") is None:
        pytest.skip("ffprobe is not installed: nobody can look at the film")
    ask = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", str(folder / name)]
    (video,) = json.loads(subprocess.run(ask, capture_output=True, check=True, timeout=60).stdout)["streams"]
    assert (video["width"], video["height"]) == (1280, 720)
    assert int(video["nb_read_frames"]) >= 3  # of 30: a busy machine records fewer


def test_a_file_that_is_dropped_plays_and_the_background_is_chosen(page: Any, clip: Clip, recording: Path) -> None:
    """Over a live stream: its file plays instead and can be sought; the background shows and is kept in the address."""
    with serving(create_app(clip, Behaviour(newest=3), recording.parent)) as url:
        page.goto(f"{url}/?quality=high&background=ff0000")
        shows(page, "s.version === 3 && s.source === 'cameras'")
        assert np.abs(picture(page)[0, 0] - [1, 0, 0]).max() < 0.02
        page.evaluate(DROP, "/files/clip.slod")
        shows(page, f"s.source === 'recording' && s.window?.newest.version === {len(clip.states) - 1}")
        page.evaluate("streamlod.pause(); streamlod.seek(7)")
        shows(page, "s.version === 7 && s.phase === 'paused'")
        assert page.title().startswith("clip.slod")
        assert page.locator("#t-live").is_hidden()
        page.locator("#b-more, #b-quality >> visible=true").first.click(**WAIT)
        page.locator("#b-quality").click(**WAIT)
        page.evaluate("""() => {
          const field = document.querySelector("#quality-menu input[type=color]");
          field.value = "#00ff00";
          field.dispatchEvent(new Event("input"));
        }""")
        eventually(lambda: _is_green(page))
        assert "background=00ff00" in page.url
        sharp = picture(page)
        page.get_by_label("Depth of field").fill("100")
        eventually(lambda: _is_other(page, sharp))
        assert "blur=100" in page.url


def _is_other(page: Any, before: np.ndarray) -> None:
    assert np.abs(picture(page) - before).mean() > 0.002


def _is_green(page: Any) -> None:
    assert np.abs(picture(page)[0, 0] - [0, 1, 0]).max() < 0.02
