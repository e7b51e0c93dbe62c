"""The page as a wheel brings it: compressed, within its budget, and still working."""

from __future__ import annotations

import asyncio
import gzip
import importlib
import math
import struct
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from streamlod.codec.container import SlodWriter
from tests.client.web.miniserver import WEB, Behaviour, Clip, create_app, serving
from tests.client.web.watching import INSPECT, shows

pytestmark = pytest.mark.browser

ROOT = WEB.parents[1]
FRAMES = 40
MAX_BYTES = 120_000  # of all that a live viewer loads: a tenth of a second over 10 Mbit/s


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory, kernel: bytes) -> Path:
    """The page's folder with what the build hook adds to it."""
    brotli = pytest.importorskip("brotli", reason="brotli packs the page: pip install brotli hatchling")
    pytest.importorskip("hatchling", reason="hatchling builds the wheel: pip install brotli hatchling")
    out = tmp_path_factory.mktemp("wheel")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        build = importlib.import_module("hatchling.build")
        wheel = out / build.build_wheel(str(out))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(out, [name for name in archive.namelist() if name.startswith("streamlod/client/web/")])
    folder = out / "streamlod" / "client" / "web"
    script = (WEB / "ui" / "main.js").read_bytes()
    assert brotli.decompress((folder / "ui" / "main.js.br").read_bytes()) == script
    assert gzip.decompress((folder / "ui" / "main.js.gz").read_bytes()) == script
    assert (folder / "decode" / "kernel.wasm").read_bytes() == kernel
    return folder


def test_works_compressed_and_is_small(page: Any, clip: Clip, packed: Path) -> None:
    """Chromium loads the compressed files and shows the stream; nothing is loaded that a live viewer does not need."""
    sizes: dict[str, int] = {}

    def note(response: Any) -> None:
        coding, name = response.headers.get("content-encoding"), response.url.rpartition("/")[2]
        if "/v1/" not in response.url:
            assert coding == "br", response.url
            sizes[name] = int(response.headers["content-length"])

    page.on("response", note)
    with serving(create_app(clip, Behaviour(newest=4), page=packed)) as url:
        page.goto(f"{url}/")
        shows(page, "s.version === 4")
    assert {"main.js", "worker.js", "kernel.wasm"} <= set(sizes)
    assert not {"recording.js", "file.js", "moments.js", "thin.js", "webxr.js"} & set(sizes)
    assert sum(sizes.values()) < MAX_BYTES, sizes


class SlowLink:
    """Everything that an application answers, over one link of so many bytes a second; at first, what takes `seconds`.

    Then it waits for `open`: what has come over it till then does not depend on how fast the page is.
    """

    def __init__(self, app: ASGIApp, rate: float, seconds: float) -> None:
        self.app, self.rate, self.left, self.free = app, rate, rate * seconds, 0.0

    def open(self) -> None:
        """Pass on everything, quickly."""
        self.rate, self.left = 1e9, math.inf

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, a little at a time."""

        async def slowly(message: Message) -> None:
            body = message.get("body", b"")
            for at in range(0, len(body), 2048):
                piece = body[at : at + 2048]
                while self.left < len(piece):
                    await asyncio.sleep(0.02)
                self.left -= len(piece)
                self.free = max(self.free, time.monotonic()) + len(piece) / self.rate
                await asyncio.sleep(self.free - time.monotonic())
                await send({**message, "body": piece, "more_body": True})
            await send({**message, "body": b""} if body else message)

        await self.app(scope, receive, slowly)


def padded(packet: bytes, sizes: dict[int, int]) -> bytes:
    """`packet` with an extension chunk of so many bytes in each of these levels (codec/FORMAT.md, section 2)."""
    count = int.from_bytes(packet[30:32], "little")
    directory = np.frombuffer(packet, "<u4", 2 * count, 44).reshape(count, 2)
    chunks, at = [], 44 + 8 * count
    for entry, checksum in directory.tolist():
        chunks.append((entry, checksum, packet[at : (at := at + (entry & 0xFFFFFF))]))
    for level, size in sizes.items():
        body = bytes(size)
        chunks.append((level << 28 | 15 << 24 | size, zlib.crc32(body), body))
    chunks.sort()
    head = packet[:30] + len(chunks).to_bytes(2, "little") + packet[32:40]
    listed = b"".join(struct.pack("<II", entry, checksum) for entry, checksum, _ in chunks)
    return head + struct.pack("<I", zlib.crc32(head + listed)) + listed + b"".join(body for _, _, body in chunks)


def test_a_file_over_a_slow_link_shows_coarse_levels_first(page: Any, clip: Clip, packed: Path, tmp_path: Path) -> None:
    """500 kbit/s and a keyframe of 900 kB: page and coarse level have come after 4 s; in the end it is all there."""
    with SlodWriter(tmp_path / "clip.slod") as writer:
        writer.append(padded(clip.key(), {0: 80_000, 1: 320_000, 2: 500_000}))
        writer.append(clip.residual(0, 1))
    link = SlowLink(create_app(clip, Behaviour(), tmp_path, page=packed), 500_000 / 8, seconds=4)
    with serving(link) as url:
        page.goto(f"{url}/?src=files/clip.slod&quality=high")
        shows(page, "s.version === 0 && s.splats > 0")
        coarse = page.evaluate("streamlod.state.splats")
        link.open()
        shows(page, "s.version === 1")
        assert page.evaluate("streamlod.state.splats") > 2 * coarse
        assert page.evaluate(INSPECT)["digests"] == [level.digest() for level in clip.states[1].levels]


@pytest.mark.parametrize("playing", [False, True])
def test_a_seek_while_the_first_keyframe_comes_is_kept(
    page: Any, clip: Clip, packed: Path, tmp_path: Path, playing: bool
) -> None:
    """Who has gone elsewhere before all of the first keyframe is there is not led back, nor carried on meanwhile."""
    with SlodWriter(tmp_path / "clip.slod") as writer:
        writer.append(padded(clip.key(), {0: 20_000, 1: 80_000, 2: 500_000}))
        for version in range(FRAMES - 1):
            writer.append(clip.residual(version, version + 1))
    link = SlowLink(create_app(clip, Behaviour(), tmp_path, page=packed), 60_000, seconds=4)
    with serving(link) as url:
        page.goto(f"{url}/?src=files/clip.slod&quality=high")
        shows(page, "s.version === 0 && s.splats > 0")
        page.evaluate("window.seen = []; streamlod.on('picture', (picture) => seen.push(picture.version)); 0")
        page.evaluate(f"{'' if playing else 'streamlod.pause();'} streamlod.seek(2)")
        page.wait_for_timeout(2000)  # longer than the recording
        link.open()
        shows(page, f"s.version === {FRAMES - 1 if playing else 2}")
        first = next(version for version in page.evaluate("seen") if version > 0)
        assert first == 2 or (playing and 2 < first < FRAMES - 1)  # a busy machine leaves some out


def test_codings_as_asked_for(packed: Path, clip: Clip) -> None:
    """br before gzip before plain; types stay; a copy that is still good is not sent again."""
    with serving(create_app(clip, Behaviour(), page=packed)) as url, httpx.Client(base_url=url) as client:
        plain = client.get("/ui/main.js", headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.content == (packed / "ui" / "main.js").read_bytes()
        for accept, coding in (("gzip, br", "br"), ("gzip", "gzip"), ("br;q=0, gzip", "gzip"), ("zstd", None)):
            answer = client.get("/", headers={"Accept-Encoding": accept, "Sec-Fetch-Dest": "document"})
            assert answer.headers.get("content-encoding") == coding
            assert answer.headers["content-type"].startswith("text/html")
            assert answer.headers["vary"] == "Accept-Encoding, Sec-Fetch-Dest"
        etag = answer.headers["etag"]
        validated = {"Accept-Encoding": "zstd", "Sec-Fetch-Dest": "document", "If-None-Match": etag}
        again = client.get("/", headers=validated)
        assert again.status_code == 304
        wasm = client.get("/decode/kernel.wasm", headers={"Accept-Encoding": "gzip"})
        assert wasm.headers["content-type"] == "application/wasm"
        assert wasm.content[:4] == b"\0asm"
        hidden = ("/../app.py", "/ui/..%2f..%2f__init__.py", "/ui/%2e%2e/%2e%2e/__init__.py", "/decode", "/ui/no.js")
        for path in hidden:
            assert client.get(path, headers={"Accept-Encoding": "gzip"}).status_code == 404, path
