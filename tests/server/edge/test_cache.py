"""nginx, with the configuration of docker/proxy, as the cache in front of a recording and the way to two edges."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from streamlod.server.auth.gate import hash_token
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import EdgeSettings, Settings
from tests.server.conftest import Clip, Running, Viewer, running, viewing
from tests.server.ports import free_ports
from tests.waiting import wait

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is not installed"),
]

CONFIGURATION = Path(__file__).parents[3] / "docker" / "proxy" / "nginx-edges.conf"
VIEWERS = 20
FORMAT = "log_format bytes '$uri $upstream_cache_status $body_bytes_sent $upstream_response_length';"


@dataclass(frozen=True, slots=True)
class Proxy:
    """nginx at `port`; it logs each request's cache status, bytes sent and bytes that came from the origin."""

    port: int
    log: Path

    def entries(self, count: int) -> list[list[str]]:
        """The log's lines, `count` at least."""
        wait(lambda: len(self.log.read_text().splitlines()) >= count)
        return [line.split() for line in self.log.read_text().splitlines()]


def is_open(port: int) -> bool:
    with socket.socket() as peer:
        return peer.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def nginx(folder: Path, origin: int, edges: tuple[int, int]) -> Iterator[Proxy]:
    (own,), log = free_ports(1), folder / "access.log"
    text = CONFIGURATION.read_text().replace("/var/cache/nginx/streamlod", str(folder / "cache"))
    for place, port in ((8000, origin), (8001, edges[0]), (8002, edges[1])):
        text = re.sub(rf"127\.0\.0\.1:{place}\b", f"127.0.0.1:{port}", text)
    text = text.replace("listen 8080", f"listen 127.0.0.1:{own}")
    temporary = "".join(
        f"{name}_temp_path {folder / name};" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    user = "user root;" if os.getuid() == 0 else ""  # who else could not write into the folder
    (folder / "nginx.conf").write_text(
        f"{user} daemon off; pid {folder / 'pid'}; error_log stderr; events {{}} "
        f"http {{ {temporary} {FORMAT} access_log {log} bytes; {text} }}"
    )
    process = subprocess.Popen(["nginx", "-p", folder, "-c", folder / "nginx.conf"], stderr=subprocess.DEVNULL)
    try:
        wait(lambda: is_open(own))
        yield Proxy(own, log)
    finally:
        process.terminate()
        process.wait()


def play(proxy: Proxy, paths: list[str]) -> list[bytes]:
    """One viewer that downloads a recording's groups."""
    with httpx.Client(base_url=f"http://127.0.0.1:{proxy.port}", trust_env=False) as client:
        return [client.get(path).raise_for_status().content for path in paths]


def test_a_recording_leaves_the_origin_once(clip: Clip, tmp_path: Path) -> None:
    with running(Settings(state=tmp_path / "state"), StreamSpec(play=clip.path, loop=False)) as origin:
        origin.wait(lambda stream: stream["state"] == "ended")
        with origin.client() as client:
            groups = client.get("/v1/streams/main/manifest").json()["gops"]
            closed = [group["path"] for group in groups[:-1]]
            packets = [closed[0].replace("gops/1/0", f"packets/1/{version}") for version in range(10)]
            direct = [client.get(path).content for path in (*closed, *packets)]
        with nginx(tmp_path, origin.port, (origin.port, origin.port)) as proxy:
            for _ in range(VIEWERS):
                assert play(proxy, [*closed, *packets]) == direct
            entries = proxy.entries(VIEWERS * len(direct))
            counts = Counter(status for _, status, *_ in entries)
            assert counts == {"MISS": len(direct), "HIT": (VIEWERS - 1) * len(direct)}
            sent = sum(int(size) for _, _, size, _ in entries)
            fetched = sum(int(size) for *_, size in entries if size != "-")
            assert fetched == sum(map(len, direct))
            assert sent == VIEWERS * fetched
            with httpx.Client(base_url=f"http://127.0.0.1:{proxy.port}", trust_env=False) as client:
                part = client.get(closed[0], headers={"Range": "bytes=10-19"})
            assert (part.status_code, part.content) == (206, direct[0][10:20])
            open_group = groups[-1]["path"]
            assert play(proxy, [open_group]) == play(proxy, [open_group])
            assert "HIT" not in [status for path, status, *_ in proxy.entries(1) if path == open_group]
    assert counts["HIT"] / sum(counts.values()) > 0.9


def test_what_was_fetched_with_a_token_or_a_signature_is_for_nobody_else(clip: Clip, tmp_path: Path) -> None:
    entry = {"name": "reader", "sha256": hash_token("reader"), "rights": ["read"]}
    (tmp_path / "tokens.json").write_text(json.dumps([entry]))
    settings = Settings(tokens=tmp_path / "tokens.json")
    bearer = {"Authorization": "Bearer reader"}
    with running(settings, StreamSpec(play=clip.path, loop=False)) as origin:
        with origin.client(headers=bearer) as client:
            wait(lambda: client.get("/v1/streams/main").json()["state"] == "ended")
            paths = [group["path"] for group in client.get("/v1/streams/main/manifest").json()["gops"]]
            query = client.post("/v1/streams/main/links", json={"seconds": 60}).json()["query"]
        with (
            nginx(tmp_path, origin.port, (origin.port, origin.port)) as proxy,
            httpx.Client(base_url=f"http://127.0.0.1:{proxy.port}", trust_env=False) as client,
        ):
            for path in paths:
                for _ in range(2):
                    assert client.get(path, headers=bearer).status_code == 200
                    assert client.get(f"{path}?{query}").status_code == 200
                assert client.get(path).status_code == 401
                assert client.get(f"{path}?signature=no").status_code == 401
            assert {status for _, status, *_ in proxy.entries(6 * len(paths))} <= {"BYPASS", "MISS"}


def test_viewers_of_an_edge_that_drains_go_on_at_the_other_one(long_clip: Clip, tmp_path: Path) -> None:
    with ExitStack() as stack, ExitStack() as leaving:
        origin = stack.enter_context(running(Settings(), StreamSpec(play=long_clip.path)))
        edge = Settings(edge=EdgeSettings(origin=origin.url, poll_seconds=0.1))
        stays = stack.enter_context(running(edge))
        goes = leaving.enter_context(running(edge))
        proxy = stack.enter_context(nginx(tmp_path, origin.port, (goes.port, stays.port)))
        for each in (goes, stays):
            wait(lambda each=each: "main" in each.registry.streams)
        viewers = [stack.enter_context(through(proxy)) for _ in range(2)]
        for viewer in viewers:
            viewer.until("caught_up")
        assert [viewers_of(goes), viewers_of(stays)] == [1, 1]
        leaving.close()
        gone, code = first_ended(viewers)
        assert code == 1001  # to come again
        viewers.remove(gone)
        for _ in range(10):
            viewers[0].next_packet()  # which notices nothing
        with through(proxy) as viewer:
            viewer.until("caught_up")
            assert viewer.decoder.scene is not None
            assert viewers_of(stays) == 2


def first_ended(viewers: list[Viewer]) -> tuple[Viewer, int | None]:
    """The one whose connection is closed first while all of them read, and the code that it was closed with."""
    while True:
        for viewer in viewers:
            try:
                viewer.next_packet()
            except ConnectionClosed as error:
                return viewer, error.rcvd.code if error.rcvd else None


def viewers_of(server: Running) -> int:
    return server.registry.streams["main"].viewers


@contextmanager
def through(proxy: Proxy) -> Iterator[Viewer]:
    with viewing(Running(None, proxy.port, None), max_queue=None) as viewer:  # type: ignore[arg-type]
        yield viewer.hello()
