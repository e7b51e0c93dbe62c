"""What a phone's page says to who carries the board, while `streamlod rig` records: Chromium films pictures of one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from streamlod.core.arrays import UInt8
from tests.client.web.conftest import CAMERA_FLAGS, TEST_FLAGS, chromium_path
from tests.client.web.phones import opened, recorded, says
from tests.server.ingest.push.stage import FPS
from tests.server.ingest.test_walk import SIZE, seen_at

pytestmark = pytest.mark.browser


def written(file: Path, picture: UInt8) -> Path:
    """A grey picture as a fake camera's video."""
    height, width = picture.shape[:2]
    begin = f"YUV4MPEG2 W{width} H{height} F{FPS}:1 Ip A1:1 C420jpeg\nFRAME\n"
    file.write_bytes(begin.encode() + picture[..., 0].tobytes() + bytes([128]) * (width * height // 2))
    return file


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ((-0.25, -0.15), "the board is seen, now: upper right"),
        ((0.0, 0.0), "enough"),
    ],
    ids=["seen", "enough"],
)
def test_a_page_says_what_its_picture_needs_of_the_board(
    chromium: Any, tmp_path: Path, place: tuple[float, float], text: str
) -> None:
    """In letters of a centimetre on a phone seven wide, for three metres. Before and after, nothing is said."""
    address, recording = recorded(tmp_path, [], SIZE, 15.0)
    clip = f"--use-file-for-fake-video-capture={written(tmp_path / 'board.y4m', seen_at(*place))}"
    flags = [*TEST_FLAGS, *CAMERA_FLAGS, clip]
    browser = chromium.browser_type.launch(executable_path=chromium_path(), args=flags)
    with opened(browser, address, ignore_https_errors=True) as page:
        says(page, "Ready to film")
        assert page.is_hidden("#board")
        page.click("#film")
        page.wait_for_function("(text) => document.getElementById('board').textContent === text", arg=text)
        assert page.is_visible("#board")
        assert page.eval_on_selector("#board", "(board) => board.scrollWidth <= board.clientWidth")
        assert page.eval_on_selector("#board", "(board) => parseFloat(getComputedStyle(board).fontSize)") >= 400 / 7
        says(page, "Trying again")
        assert page.is_hidden("#board")
        page.complaints.forgive("ERR_CONNECTION")
    browser.close()
    recording.join(60)
    assert not recording.is_alive()
