"""The operations page names what exists; metrics say what happened; the server loads nothing heavy."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from prometheus_client import generate_latest
from pydantic import BaseModel

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.metrics import collector_registry
from streamlod.server.settings import (
    EdgeSettings,
    JetStreamSettings,
    Limits,
    RaySettings,
    Retention,
    Settings,
    Webhook,
    WorkerSettings,
    load_settings,
)
from tests.server.conftest import Clip, running, viewing

PAGE = (Path(__file__).parents[2] / "docs" / "operations.md").read_text()


def test_every_setting_is_documented_with_its_default() -> None:
    models: tuple[tuple[str, type[BaseModel]], ...] = (
        ("", Settings), ("limits.", Limits), ("retention.", Retention), ("worker.", WorkerSettings),
        ("webhooks.", Webhook), ("edge.", EdgeSettings), ("jetstream.", JetStreamSettings),
        ("ray.", RaySettings),
    )  # fmt: skip
    for prefix, model in models:
        for name, field in model.model_fields.items():
            if field.default_factory is not None:
                continue
            if field.is_required():
                assert f"| `{prefix}{name}` | | {field.description} |" in PAGE, name
                continue
            default = {None: "none", False: "false", True: "true"}.get(field.default, str(field.default))
            if isinstance(field.default, tuple):
                default = json.dumps(field.default)
            if type(field.default) in (int, float):
                default = str(field.default)
            assert f"| `{prefix}{name}` | {default} | {field.description} |" in PAGE, name


def test_metrics_count_and_are_documented(clip: Clip) -> None:
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        with viewing(server) as viewer:
            viewer.hello()
            viewer.until("caught_up")
            text = generate_latest(collector_registry(server.registry)).decode()
        assert 'streamlod_viewers{stream="main"} 1.0' in text
        assert 'streamlod_joins_total{stream="main"} 1.0' in text
        names = {line.split("{")[0].split(" ")[0] for line in text.splitlines() if not line.startswith("#")}
        assert names
        for name in names:
            assert f"`{name}`" in PAGE, name


def test_alert_rules_ask_for_what_exists(clip: Clip) -> None:
    rules = (Path(__file__).parents[2] / "docker" / "observe" / "alerts.yml").read_text()
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        text = generate_latest(collector_registry(server.registry)).decode()
    names = {line.split("{")[0].split(" ")[0] for line in text.splitlines() if not line.startswith("#")}
    asked = set(re.findall(r"\b(?:streamlod|process)_\w+", " ".join(re.findall(r"expr: (.*)", rules))))
    assert len(asked) >= 8
    assert asked <= names


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is missing: apt-get install prometheus")
def test_promtool_takes_the_alert_rules() -> None:
    rules = Path(__file__).parents[2] / "docker" / "observe" / "alerts.yml"
    done = subprocess.run(["promtool", "check", "rules", rules], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_dashboard_and_its_containers_ask_for_what_exists(clip: Clip) -> None:
    folder = Path(__file__).parents[2] / "docker" / "observe"
    with running(Settings(), StreamSpec(play=clip.path)) as server:
        text = generate_latest(collector_registry(server.registry)).decode()
    names = {line.split()[2] for line in text.splitlines() if line.startswith("# TYPE")}
    board = json.loads((folder / "dashboard.json").read_text())
    panels = board["panels"]
    asked = {name for p in panels for t in p["targets"] for name in re.findall(r"streamlod_\w+", t["expr"])}
    assert len(asked) >= 12
    assert asked <= names
    for target in (target for panel in panels for target in panel["targets"]):
        assert len(re.findall(r"streamlod_\w+", target["expr"])) == target["expr"].count('{node=~"$node"')
        assert "{{node}}" in target["legendFormat"] or "{{worker_node}}" in target["legendFormat"]
    assert [each["name"] for each in board["templating"]["list"]] == ["node", "stream"]
    settings = load_settings(folder / "server.toml")
    assert f'"server:{settings.metrics_port}"' in (folder / "prometheus.yml").read_text()
    sources = (folder / "datasource.yaml").read_text()
    assert all(f"uid: {p['datasource']['uid']}," in sources for p in panels)
