"""SIGHUP: other limits and webhooks hold at once, while viewers stay; what cannot be used changes nothing."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import httpx
import pytest

from tests.e2e.test_server_process import serving
from tests.server.conftest import Clip
from tests.server.service.test_webhooks import receiver
from tests.waiting import wait


@pytest.mark.long
def test_limits_and_webhooks_are_read_again(clip: Clip, tmp_path: Path) -> None:
    config = tmp_path / "server.toml"
    (tmp_path / "key").write_text("k" * 40)
    with receiver(200) as (first, to_first), receiver(200) as (second, to_second):

        def put(text: str) -> None:
            """Whole at once: the server may be about to read, and an empty file holds good settings too."""
            (tmp_path / "new").write_text(text)
            (tmp_path / "new").replace(config)

        def write(streams: int, *urls: str, more: str = "") -> None:
            kinds = "events = ['stream.created', 'stream.deleted']"
            hooks = "".join(f"[[webhooks]]\nurl = '{url}'\nkey = '{tmp_path}/key'\n{kinds}\n" for url in urls)
            lines = ["roots = ['/']", "networks = ['localhost']", more, "[limits]", f"streams = {streams}", hooks]
            put("\n".join(lines))

        write(1, first)
        with (
            serving("--play", clip.path, "--config", config) as (process, port),
            httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=60) as client,
        ):

            def limit() -> int:
                return int(client.get("/v1/server").json()["limits"]["streams"])

            def create(name: str) -> int:
                return client.post("/v1/streams", json={"id": name, "play": str(clip.path)}).status_code

            assert (limit(), create("a")) == (1, 422)
            write(3, first, second, more="camera_pictures = true")
            process.send_signal(signal.SIGHUP)
            wait(lambda: limit() == 3)
            assert create("a") == 201
            wait(lambda: len(to_second) == 1)
            assert json.loads(to_second[0][1])["type"] == "stream.created"
            for text in ("[limits]\nstreams = 'many'", "[limits", "[[webhooks]]\nurl = 'http://x/'\nkey = '/none'"):
                put(text)
                process.send_signal(signal.SIGHUP)
            assert create("b") == 201  # the limits before stay
            wait(lambda: len(to_second) == 2)
            write(2, second)
            process.send_signal(signal.SIGHUP)
            wait(lambda: limit() == 2)
            assert create("c") == 422  # there are three
            before = len(to_first)
            assert client.delete("/v1/streams/b").status_code == 204
            wait(lambda: len(to_second) == 3)
            assert json.loads(to_second[2][1])["type"] == "stream.deleted"
            assert len(to_first) == before
