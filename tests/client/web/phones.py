"""Pages on which phones film, and what tests ask of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from streamlod.server.cli.rig import find, watch
from streamlod.server.settings import Settings, load_settings
from tests.client.web.conftest import Console
from tests.client.web.watching import WAIT
from tests.server.ingest.push.stage import FPS, HEIGHT, WIDTH, Stage, rig, stage


@contextmanager
def opened(phone: Any, address: str, **options: Any) -> Iterator[Any]:
    """A page of its own at an address; its console stays empty."""
    context = phone.new_context(viewport={"width": 400, "height": 700}, reduced_motion="reduce", **options)
    page = context.new_page()
    page.set_default_timeout(WAIT["timeout"])
    page.complaints = Console(page)
    page.goto(address)
    yield page
    context.close()
    page.complaints.forgive("WebSocket connection")  # the browser's remark on connections that fail
    assert page.complaints.lines == []


def says(page: Any, text: str) -> None:
    """Wait until the page's state is that sentence, or part of it."""
    page.wait_for_function("(text) => document.getElementById('status-text').textContent.includes(text)", arg=text)


def figure(page: Any, name: str) -> str:
    """A figure that the page shows; the table is drawn anew each second, at first a second after the page."""
    shown = page.wait_for_function(
        "(name) => [...document.querySelectorAll('#figures dt')].find((term) => term.textContent === name)"
        "?.nextSibling.textContent",
        arg=name,
    )
    return str(shown.json_value())


@contextmanager
def filmed(phone: Any, instants: int) -> Iterator[tuple[Stage, Any]]:
    """A page that films for a stream, which has got so many instants."""
    with stage(Settings(), rig((WIDTH, HEIGHT), 1)) as found, opened(phone, found.page()) as page:
        says(page, "Ready to film")
        page.click("#film")
        found.wait(instants)
        yield found, page


def recorded(
    folder: Path, sources: list[str], size: tuple[int, int], seconds: float, sound: str | None = None
) -> tuple[str, threading.Thread]:
    """The address of a phone's page, and the thread in which `streamlod rig` records it beside `sources`."""
    file, said = folder / "rig.json", list[str]()
    find(sources, file, 1, size, FPS, said.append, sound=sound, overwrite=False)
    settings = load_settings(folder / "rig.toml").model_copy(update={"host": "127.0.0.1", "port": 0})
    recording = threading.Thread(
        target=lambda: watch(file, folder / "walk", seconds, settings, said.append, overwrite=False), daemon=True
    )
    recording.start()
    limit = time.monotonic() + 60
    while not (pages := [line.rpartition(" ")[2] for line in said if "each phone: https://" in line]):
        assert time.monotonic() < limit, said
        time.sleep(0.05)
    return pages[0], recording
