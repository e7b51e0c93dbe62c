"""Client addresses: as they are, as a trusted proxy tells them, and never as a client would like them."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from streamlod.core.errors import InputError
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.server.conftest import Clip, Running, running, viewing
from tests.server.ports import held_ports

_CONFIGURATIONS = Path(__file__).parents[2] / "docker" / "proxy"


def addresses(server: Running) -> set[str]:
    return set(server.registry.sessions.values())


@pytest.mark.parametrize(
    ("proxies", "header", "seen"),
    [
        ((), "203.0.113.9", "127.0.0.1"),
        (("10.0.0.0/8",), "203.0.113.9", "127.0.0.1"),
        (("127.0.0.1",), "203.0.113.9", "203.0.113.9"),
        (("127.0.0.1",), "198.51.100.1, 203.0.113.9", "203.0.113.9"),
        (("127.0.0.0/8", "10.0.0.0/8"), "198.51.100.1, 203.0.113.9, 10.1.1.1", "203.0.113.9"),
    ],
)
def test_only_a_trusted_proxy_says_where_a_viewer_is(
    clip: Clip, proxies: tuple[str, ...], header: str, seen: str
) -> None:
    with (
        running(Settings(proxies=proxies), StreamSpec(play=clip.path)) as server,
        viewing(server, additional_headers={"X-Forwarded-For": header}) as viewer,
    ):
        viewer.hello()
        assert addresses(server) == {seen}


def test_wrong_tokens_are_counted_for_the_client_and_not_for_its_claims(tmp_path: Path) -> None:
    (tmp_path / "tokens").write_text("[]")
    settings = Settings(tokens=tmp_path / "tokens", limits=Limits(refusals_per_minute=2))
    with running(settings) as server, server.client() as client:
        found = [
            client.get("/v1/streams", headers={"Authorization": "Bearer x", "X-Forwarded-For": f"203.0.113.{number}"})
            for number in range(4)
        ]
    assert [answer.status_code for answer in found] == [401, 401, 429, 429]


def test_a_network_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="proxies"):
        Settings(proxies=("everybody",)).check()


def is_open(port: int) -> bool:
    with socket.socket() as peer:
        return peer.connect_ex(("127.0.0.1", port)) == 0


@contextmanager
def proxy(program: str, folder: Path, port: int, path: str = "") -> Iterator[int]:
    """The program with its configuration of docker/proxy, on a free port, in front of a server.

    Args:
        path: shows the server under it, as docs/operations.md says for nginx.
    """
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    source = {"nginx": "nginx.conf", "caddy": "Caddyfile"}[program]
    text = (_CONFIGURATIONS / source).read_text().replace("127.0.0.1:8000", f"127.0.0.1:{port}")
    if path:
        text = text.replace("location / {", f"location {path}/ {{ proxy_set_header X-Forwarded-Prefix {path};")
        text = text.replace(f"proxy_pass http://127.0.0.1:{port};", f"proxy_pass http://127.0.0.1:{port}/;")
    with held_ports(1) as (own,):
        text = re.sub(r"(listen |^:)8080", rf"\g<1>{'127.0.0.1:' if program == 'nginx' else ''}{own}", text, flags=re.M)
        if program == "nginx":
            temporary = "".join(
                f"{kind}_temp_path {folder}/{kind};" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
            )
            text = f"daemon off; pid {folder}/pid; events {{}} http {{ access_log off; {temporary} {text} }}"
        else:
            text = text.replace("auto_https off", "auto_https off\n\tdefault_bind 127.0.0.1")
        (folder / source).write_text(text)
        command = {
            "nginx": ["nginx", "-e", f"{folder}/errors", "-p", str(folder), "-c", str(folder / source)],
            "caddy": ["caddy", "run", "--adapter", "caddyfile", "--config", str(folder / source)],
        }[program]
        with (folder / "log").open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
            try:
                limit = time.monotonic() + 60
                while not is_open(own):
                    assert process.poll() is None, (folder / "log").read_text()
                    assert time.monotonic() < limit
                    time.sleep(0.1)
                yield own
            finally:
                process.terminate()
                process.wait(60)


@pytest.mark.parametrize("program", ["nginx", "caddy"])
def test_viewers_and_downloads_pass_a_real_proxy(tmp_path: Path, clip: Clip, program: str) -> None:
    settings = Settings(proxies=("127.0.0.1",))
    with running(settings, StreamSpec(play=clip.path)) as server, proxy(program, tmp_path, server.port) as port:
        server.wait(lambda stream: stream["state"] == "live")
        behind = Running(server.registry, port, server.loop)
        with viewing(behind, additional_headers={"X-Forwarded-For": "203.0.113.9"}) as viewer:
            viewer.hello()
            viewer.until("caught_up")
            viewer.next_packet()
            assert addresses(server) == {"127.0.0.1"}  # what the client claims is not passed on
        with behind.client() as client:
            whole = client.get("/v1/streams/main/packets/1/0")
            part = client.get("/v1/streams/main/packets/1/0", headers={"Range": "bytes=2-5"})
            assert (whole.content, part.status_code, part.content) == (clip.packets[0], 206, clip.packets[0][2:6])
            assert client.post("/v1/streams/main/stop").status_code == 202
