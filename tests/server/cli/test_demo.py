"""What the demo does besides running other commands."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

OPEN = "import logging; logging.basicConfig(level=20); from streamlod.server.cli.demo import open_page; print(open_page('http://h:1'))"


@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="there is always a screen")
@pytest.mark.parametrize("screen", [True, False])
def test_opens_the_page_where_there_is_a_screen(tmp_path: Path, screen: bool) -> None:
    """The user's own browser gets the address; without a screen it is told."""
    seen, browser = tmp_path / "seen", tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\necho "$1" > {seen}\n')
    browser.chmod(0o755)
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"BROWSER": f"{browser} %s"} | ({"DISPLAY": ":0"} if screen else {})
    done = subprocess.run(
        [sys.executable, "-c", OPEN], env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == str(screen)
    assert seen.exists() == screen
    assert "http://h:1" in (seen.read_text() if screen else done.stderr)
