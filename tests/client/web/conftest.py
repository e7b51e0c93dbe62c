"""Fixtures of the page's tests: the assembled kernel, node, Chromium."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

WEB = Path(__file__).parents[3] / "client" / "web"
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


def chromium_path() -> str | None:
    """The browser to drive: CHROMIUM, or what the system has."""
    return os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="session")
def kernel() -> bytes:
    """kernel.wasm, assembled anew where the checkout's is missing or older than its text."""
    wasmtime = pytest.importorskip("wasmtime", reason="wasmtime assembles the page's kernel: pip install wasmtime")
    assembled = bytes(wasmtime.wat2wasm((WEB / "decode" / "kernel.wat").read_text()))
    target = WEB / "decode" / "kernel.wasm"
    if not target.exists() or target.read_bytes() != assembled:
        target.write_bytes(assembled)
    return assembled


@pytest.fixture(scope="session")
def node(kernel: bytes) -> str:
    """The node command, or a skip."""
    found = shutil.which("node")
    if found is None:
        pytest.skip("node is not installed: the page's modules are tested with node 20 or newer")
    return found


@pytest.fixture(scope="module")
def chromium(kernel: bytes) -> Iterator[Any]:
    """A headless Chromium through Playwright, or a skip.

    For one module only: while it is open, Playwright keeps an event loop running, under which asyncio.run refuses.
    """
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    path = chromium_path()
    if path is None:
        pytest.skip("Chromium is not installed: apt-get install chromium, or set CHROMIUM to its path")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
        yield browser
        browser.close()
