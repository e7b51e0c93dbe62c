"""The page left running: no errors, no objects piling up, flat memory. On request: `pytest -m slow`."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import pytest

from tests.client.web.miniserver import Behaviour, create_app, make_clip, serving
from tests.client.web.scenes import make_scene
from tests.client.web.watching import COUNT_OBJECTS, shows

pytestmark = [pytest.mark.slow, pytest.mark.browser, pytest.mark.timeout(900)]

ORBIT_SECONDS = int(os.environ.get("STREAMLOD_ORBIT_SECONDS", "30"))


def resident_bytes() -> int:
    """Memory of all processes that draw pages or decode for them: their workers' too. 0 where /proc is missing."""
    total = 0
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if b"--type=renderer" in (folder / "cmdline").read_bytes():
                total += int((folder / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return total


def test_auto_quality_on_a_slow_machine(page: Any) -> None:
    """Frames that take 350 ms: less resolution while it plays, never fewer levels; what rests is sharp and whole."""
    page.add_init_script("window.requestAnimationFrame = (act) => setTimeout(() => act(performance.now()), 350)")
    behaviour = Behaviour(fps=15)
    with serving(create_app(make_clip(make_scene(600), 200), behaviour)) as url:
        page.goto(f"{url}/")
        shows(page, "s.version >= 1")
        everything = page.evaluate("streamlod.state.splats")
        width = "document.getElementById('canvas').width"
        page.wait_for_function(f"{width} < 130", timeout=30_000)
        page.evaluate("streamlod.pause()")
        page.wait_for_function(f"{width} === 320", timeout=30_000)
        assert page.evaluate("streamlod.state.splats") > 0.9 * everything
        assert behaviour.wishes == []


def test_orbiting_while_frames_arrive(page: Any) -> None:
    """A 5k-splat stream in a loop under a turning camera."""
    page.add_init_script(COUNT_OBJECTS)
    clip = make_clip(make_scene(1250), 60)
    with serving(create_app(clip, Behaviour(fps=20))) as url:
        page.goto(f"{url}/?quality=high")
        shows(page, "s.version >= 1")
        page.evaluate("streamlod.loop(true)")
        page.evaluate("window.pictures = 0; streamlod.on('picture', () => pictures++); 0")
        session = page.context.new_cdp_session(page)
        heaps, objects, processes = [], [], []
        page.keyboard.down("ArrowLeft")
        for _ in range(6):
            page.wait_for_timeout(ORBIT_SECONDS * 1000 / 6)
            session.send("HeapProfiler.collectGarbage")
            heaps.append(session.send("Runtime.getHeapUsage")["usedSize"])
            objects.append(page.evaluate("({ ...objects })"))
            processes.append(resident_bytes())
        page.keyboard.up("ArrowLeft")
        assert page.evaluate("pictures") > ORBIT_SECONDS
    assert all(count == objects[0] for count in objects)
    assert heaps[-1] < heaps[1] + 1_000_000
    assert processes[-1] < processes[1] + 40_000_000, processes
    page.complaints.forgive("WebSocket connection to")
