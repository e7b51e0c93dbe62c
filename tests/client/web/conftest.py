"""Fixtures of the page's tests: the assembled kernel, node, Chromium, a clip to watch, a page to watch it in."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.client.web.miniserver import WEB, Clip, make_clip
from tests.client.web.scenes import make_scene

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
# WebGL runs as ever. Putting the page together on an emulated graphics card as well would take three times as long.
TEST_FLAGS = [*CHROMIUM_FLAGS, "--disable-gpu-compositing"]
# WebGPU in software, whose canvases only such a card puts on the page.
WEBGPU_FLAGS = [
    *CHROMIUM_FLAGS,
    "--enable-unsafe-webgpu",
    "--use-webgpu-adapter=swiftshader",
    "--use-vulkan=swiftshader",
    "--enable-features=Vulkan",
]

CAMERA_FLAGS = [
    *("--use-fake-device-for-media-stream=device-count=1,fps=20", "--use-fake-ui-for-media-stream"),
    "--disable-renderer-backgrounding",
]


def chromium_path() -> str | None:
    """The browser to drive: CHROMIUM, or what the system has.

    The headless shell is the same engine without the windows around its pages, which take half the time of a test.
    """
    names = ("chromium-headless-shell", "chromium", "chromium-browser")
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)


@pytest.fixture(scope="session")
def kernel() -> bytes:
    """kernel.wasm, assembled anew where the checkout's is missing or older than its text."""
    wasmtime = pytest.importorskip("wasmtime", reason="wasmtime assembles the page's kernel: pip install wasmtime")
    assembled = bytes(wasmtime.wat2wasm((WEB / "decode" / "kernel.wat").read_text()))
    target = WEB / "decode" / "kernel.wasm"
    if not target.exists() or target.read_bytes() != assembled:
        beside = target.with_name(f"kernel-{os.getpid()}")  # without a suffix, so that nobody serves or packs it
        beside.write_bytes(assembled)
        beside.replace(target)  # whole at once: other processes may be reading it
    return assembled


@pytest.fixture(scope="session")
def node(kernel: bytes) -> str:
    """The node command, or a skip."""
    found = shutil.which("node")
    if found is None:
        pytest.skip("node is not installed: the page's modules are tested with node 20 or newer")
    return found


@pytest.fixture(scope="package")
def launch(kernel: bytes) -> Iterator[Callable[[list[str]], Any]]:
    """Starts a headless Chromium with flags, through Playwright, or skips.

    For this folder only: while it is open, Playwright keeps an event loop running, under which asyncio.run refuses.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    path = chromium_path()
    if path is None:
        pytest.skip("Chromium is not installed: apt-get install chromium-headless-shell, or set CHROMIUM to its path")
    with api.sync_playwright() as playwright:
        yield lambda flags: playwright.chromium.launch(executable_path=path, args=flags)


@pytest.fixture(scope="package")
def chromium(launch: Callable[[list[str]], Any]) -> Iterator[Any]:
    """A headless Chromium, without WebGPU."""
    browser = launch(TEST_FLAGS)
    yield browser
    browser.close()


@pytest.fixture(scope="package")
def chromium_webgpu(launch: Callable[[list[str]], Any]) -> Iterator[Any]:
    """A headless Chromium with WebGPU."""
    browser = launch(WEBGPU_FLAGS)
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def phone(launch: Callable[[list[str]], Any]) -> Iterator[Any]:
    """A headless Chromium with a fake camera that asks nobody."""
    browser = launch([*TEST_FLAGS, *CAMERA_FLAGS])
    yield browser
    browser.close()


# Of the driver on tests that look at the picture, of browsers without WebGPU on pages that ask for it, and of pages
# that outlive their test's server by a moment.
REMARKS = (
    "GPU stall due to ReadPixels",
    "No available adapters",
    "ERR_CONNECTION_REFUSED",
    "ERR_TOO_MANY_RETRIES",  # the same by https
)


class Console:
    """What the page complained about; must stay empty."""

    def __init__(self, page: Any) -> None:
        self.lines: list[str] = []
        page.on("console", lambda message: self._add(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: self.lines.append(f"error: {error}"))

    def _add(self, line: str) -> None:
        if not any(remark in line for remark in REMARKS):
            self.lines.append(line)

    def forgive(self, text: str) -> None:
        """Forget lines with `text`, which the browser itself writes."""
        self.lines = [line for line in self.lines if text not in line]


@pytest.fixture(scope="session")
def clip(kernel: bytes) -> Clip:
    """Forty frames of a small scene."""
    clip = make_clip(make_scene(400), 40)
    clip.key()  # compiles what encodes, here and not while a page waits
    for version in range(1, len(clip.states)):
        clip.residual(version - 1, version)
    return clip


@pytest.fixture(scope="session")
def recording(clip: Clip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The clip as `clip.slod`, in a folder of its own."""
    path = tmp_path_factory.mktemp("recording") / "clip.slod"
    clip.write(path)
    return path


@contextmanager
def opened(browser: Any) -> Iterator[Any]:
    """A page of the rig's picture size whose console must stay empty."""
    context = browser.new_context(viewport={"width": 320, "height": 240}, reduced_motion="reduce")
    page = context.new_page()
    page.complaints = Console(page)

    def wake() -> None:
        """Move the mouse, as a hand does before it presses something; Playwright's would find the controls hidden."""
        page.mouse.move(1, 1)
        page.mouse.move(2, 2)

    page.add_locator_handler(page.locator("body.idle"), wake)
    yield page
    context.close()
    assert page.complaints.lines == []


@pytest.fixture
def page(chromium: Any) -> Iterator[Any]:
    """A page in a browser without WebGPU."""
    with opened(chromium) as page:
        yield page


@pytest.fixture
def page_webgpu(chromium_webgpu: Any) -> Iterator[Any]:
    """A page in a browser with WebGPU, in software: with `webgpu=1` in its address, it draws with it."""
    with opened(chromium_webgpu) as page:
        yield page
