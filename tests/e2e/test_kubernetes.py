"""The manifests of docker/kubernetes, as far as that can be seen without a cluster: schemas, and parts that fit."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings
from tests.e2e.test_compose import CLUSTER, FOLDER, ray_options, settings_of

yaml = pytest.importorskip("yaml", reason="PyYAML is missing: pip install pyyaml")

SCHEMAS = "1.32"  # the version of Kubernetes
CUSTOM: dict[str, Any] = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
MANIFESTS: list[dict[str, Any]] = [
    manifest for name in CUSTOM["resources"] for manifest in yaml.safe_load_all((FOLDER / name).read_text())
]
WORKLOADS = {each["metadata"]["name"]: each for each in MANIFESTS if each["kind"] in {"Deployment", "StatefulSet"}}
SERVICES = {each["metadata"]["name"]: each["spec"] for each in MANIFESTS if each["kind"] == "Service"}
CONFIGS = {each["name"]: each["files"] for each in CUSTOM["configMapGenerator"]}
OTHERS = {
    "nats": {"/healthz"},
    "proxy": {"/readyz"},
    "watch": {"/-/ready", "/-/healthy"},
    "grafana": {"/api/health"},
    "ray": set(),
}  # probes of other programs
PROBES = ("startupProbe", "readinessProbe", "livenessProbe")


def pods() -> Iterator[tuple[str, dict[str, Any]]]:
    for name, workload in WORKLOADS.items():
        yield name, workload["spec"]["template"]["spec"]


def containers(pod: dict[str, Any]) -> list[dict[str, Any]]:
    return [*pod.get("initContainers", []), *pod["containers"]]


def test_every_manifest_fits_its_schema() -> None:
    validator = pytest.importorskip(
        "kubernetes_validate", reason="kubernetes-validate is missing: pip install kubernetes-validate"
    )
    assert len(MANIFESTS) > 20
    for manifest in MANIFESTS:
        validator.validate(manifest, SCHEMAS, strict=True)
    broken = {**MANIFESTS[-1], "spec": {"ports": "8000"}}
    with pytest.raises(validator.ValidationError):
        validator.validate(broken, SCHEMAS, strict=True)


@pytest.mark.skipif(shutil.which("kubectl") is None, reason="kubectl is missing")
def test_kustomize_builds_them_with_their_configuration() -> None:
    done = subprocess.run(["kubectl", "kustomize", FOLDER], check=True, capture_output=True, text=True)
    built = list(yaml.safe_load_all(done.stdout))
    assert len(built) == len(MANIFESTS) + len(CONFIGS)
    maps = {each["metadata"]["name"]: each for each in built if each["kind"] == "ConfigMap"}
    for each in built:
        assert each["kind"] == "Namespace" or each["metadata"]["namespace"] == CUSTOM["namespace"]
        for volume in each.get("spec", {}).get("template", {}).get("spec", {}).get("volumes", []):
            assert "configMap" not in volume or volume["configMap"]["name"] in maps
    assert any("upstream streamlod_edges" in text for each in maps.values() for text in each["data"].values())


def test_they_are_the_servers_of_the_compose_profile() -> None:
    names = {"nats" if name.startswith("nats") else name for name in CLUSTER}
    assert set(WORKLOADS) == names
    for name, pod in pods():
        service = CLUSTER["nats1" if name == "nats" else name]
        (container,) = pod["containers"]
        assert container["image"] == service["image"]
        if name in {"second", "edge1", "edge2"}:
            assert container["args"][:-1] == service["command"][:-1]
        if name == "origin":
            composed = service["command"][0].replace("$$", "$")  # as compose reads it
            assert container["args"][0].split()[:-1] == composed.split()[:-1]
            assert container["args"][0].split()[-1] == "/etc/streamlod/streamlod.toml"
        if name == "ray":
            assert container["args"] == service["command"]
            assert WORKLOADS[name]["spec"]["replicas"] == service["deploy"]["replicas"]
        if name in {"origin", "ray", "grafana"}:
            assert {each["name"]: each["value"] for each in container["env"]} == service["environment"]
        if name == "proxy":
            assert container["args"][0].split("mkdir")[0] == service["command"][0].split("mkdir")[0]


def test_what_is_mounted_is_there_and_where_the_commands_look() -> None:
    for files in CONFIGS.values():
        assert all((FOLDER / file.rpartition("=")[2]).is_file() for file in files)
    for name, pod in pods():
        claims = {each["metadata"]["name"] for each in WORKLOADS[name]["spec"].get("volumeClaimTemplates", [])}
        volumes = {each["name"]: each for each in pod["volumes"]}
        places: set[str] = set()
        for container in containers(pod):
            for mount in container["volumeMounts"]:
                assert mount["name"] in claims | volumes.keys()
                config = volumes.get(mount["name"], {}).get("configMap")
                files = [] if config is None else CONFIGS[config["name"]]
                places |= {f"{mount['mountPath']}/{file.partition('=')[0].rpartition('/')[2]}" for file in files}
        words = " ".join(pod["containers"][0].get("args", [])).replace("=", " ").split()
        if name == "grafana":  # it looks into folders
            targets = {each.split(":")[1].rpartition("/")[0] for each in CLUSTER[name]["volumes"]}
            assert {place.rpartition("/")[0] for place in places} == targets
        else:
            assert len(places) == (name != "ray")
            assert places <= set(words)


@pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is missing")
def test_nginx_takes_the_command_of_the_proxy(tmp_path: Path) -> None:
    """As its image has it: `pid` is set in nginx.conf, and nothing may be set twice."""
    (container,) = WORKLOADS["proxy"]["spec"]["template"]["spec"]["containers"]
    *_, command = shlex.split(container["args"][0])
    config = tmp_path / "nginx.conf"
    config.write_text(f"error_log stderr; pid {tmp_path}/nginx.pid; events {{}}")
    done = subprocess.run(["nginx", "-t", "-c", config, "-g", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert {"/run", "/var/cache/nginx", "/etc/nginx/conf.d"} <= {
        each["mountPath"] for each in container["volumeMounts"]
    }


def test_services_lead_to_ports_that_are_open() -> None:
    pods_by_label = {name: workload["spec"]["template"]["metadata"]["labels"] for name, workload in WORKLOADS.items()}
    for name, service in SERVICES.items():
        workload = service["selector"]["app"]
        assert pods_by_label[workload] == {"app": workload} == WORKLOADS[workload]["spec"]["selector"]["matchLabels"]
        pod = service["selector"].get("statefulset.kubernetes.io/pod-name", "")
        assert pod in {"", *(f"{workload}-{n}" for n in range(WORKLOADS[workload]["spec"].get("replicas", 1)))}
        (container,) = WORKLOADS[workload]["spec"]["template"]["spec"]["containers"]
        open_ports = {each["name"]: each["containerPort"] for each in container["ports"]}
        assert {(each["targetPort"], each["port"]) for each in service["ports"]} <= set(open_ports.items()), name
    for workload in WORKLOADS.values():
        assert workload["kind"] == "Deployment" or workload["spec"]["serviceName"] in SERVICES


def test_only_what_leads_to_no_viewer_is_found_before_it_is_ready() -> None:
    """A server that drains takes no further viewers."""
    early = {name: service for name, service in SERVICES.items() if service.get("publishNotReadyAddresses")}
    assert set(early) == {"head", "nats1", "nats2", "nats3"}
    assert not any(port["name"] == "http" for service in early.values() for port in service["ports"])


def test_names_in_the_configuration_are_services() -> None:
    origin = settings_of("origin")
    wanted = [url.removeprefix("nats://") for url in origin.jetstream.servers]
    targets = yaml.safe_load((FOLDER / "cluster" / "prometheus.yml").read_text())["scrape_configs"][0]
    wanted += targets["static_configs"][0]["targets"]
    wanted += [f"{name}:6222" for name in ("nats1", "nats2", "nats3")]
    assert all(name in (FOLDER / "cluster" / "nats.conf").read_text() for name in wanted[-3:])
    head, node = (ray_options(CLUSTER[name]["command"][0]) for name in ("origin", "ray"))
    assert node["address"] == f"head:{head['port']}"
    wanted += [node["address"], "prometheus:9090"]
    wanted += ["origin:8000", "second:8000", "edge1:8000", "edge2:8000"]
    for name, _, port in (each.partition(":") for each in wanted):
        assert int(port) in {each["port"] for each in SERVICES[name]["ports"]}
    assert origin.jetstream.replicas == WORKLOADS["nats"]["spec"]["replicas"]


def test_probes_ask_for_what_there_is() -> None:
    ours = {path for route in create_app(Settings()).routes if (path := getattr(route, "path", None))}
    for name, pod in pods():
        (container,) = pod["containers"]
        ports = {each["name"] for each in container["ports"]}
        assert {"readinessProbe", "livenessProbe"} <= container.keys()
        for probe in (container[each] for each in PROBES if each in container):
            asked = probe.get("httpGet") or probe["tcpSocket"]
            assert asked["port"] in ports
            assert "path" not in asked or asked["path"].partition("?")[0] in OTHERS.get(name, ours)
        if name not in OTHERS:
            assert container["readinessProbe"]["httpGet"]["path"] == "/readyz"


def test_nothing_runs_as_root_or_without_limits_or_as_whatever_is_latest() -> None:
    namespace = next(each for each in MANIFESTS if each["kind"] == "Namespace")
    assert namespace["metadata"]["labels"]["pod-security.kubernetes.io/enforce"] == "restricted"
    for name, pod in pods():
        context = pod["securityContext"]
        assert context["runAsNonRoot"] is True
        assert context["runAsUser"] > 0
        assert context["seccompProfile"] == {"type": "RuntimeDefault"}
        assert pod["automountServiceAccountToken"] is False
        for container in containers(pod):
            assert container["image"].partition(":")[2] not in {"", "latest"}
            confined = container["securityContext"]
            assert confined == {
                "allowPrivilegeEscalation": False,
                "readOnlyRootFilesystem": True,
                "capabilities": {"drop": ["ALL"]},
            }
            for kind in ("requests", "limits"):
                assert {"cpu", "memory"} <= container["resources"][kind].keys(), name
        grace = pod.get("terminationGracePeriodSeconds", 30)
        assert grace >= Settings().drain_seconds + 10  # the rest is the end of the worker


def test_edges_ask_their_origin_by_a_name_that_it_answers_to() -> None:
    for name in ("edge1", "edge2"):
        args = WORKLOADS[name]["spec"]["template"]["spec"]["containers"][0]["args"]
        host = args[args.index("--origin") + 1].removeprefix("http://").partition(":")[0]
        assert host in SERVICES
        assert host in settings_of(host).hosts


def test_a_ray_node_has_the_cores_that_it_offers_and_listens_where_it_is_probed() -> None:
    (container,) = WORKLOADS["ray"]["spec"]["template"]["spec"]["containers"]
    options = ray_options(container["args"][0])
    assert float(container["resources"]["requests"]["cpu"]) >= options["num_cpus"] >= settings_of("origin").ray.cpus
    assert [each["containerPort"] for each in container["ports"]] == [options["node_manager_port"]]
    for name in ("origin", "ray"):  # Ray's shared memory, which is 64 MiB otherwise
        pod = WORKLOADS[name]["spec"]["template"]["spec"]
        (place,) = [each["name"] for each in pod["containers"][0]["volumeMounts"] if each["mountPath"] == "/dev/shm"]
        (volume,) = [each["emptyDir"] for each in pod["volumes"] if each["name"] == place]
        assert volume["medium"] == "Memory"
        assert int(volume["sizeLimit"].removesuffix("Mi")) << 20 > options["object_store_memory"]
