"""A real Prometheus with the shipped configuration reads a real server; every panel's question has an answer."""

from __future__ import annotations

import json
import shutil
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed

from tests.e2e.test_server_process import live, serving, wait_live
from tests.server.conftest import Clip, Viewer, make_clip
from tests.server.ports import free_ports

OBSERVE = Path(__file__).parents[2] / "docker" / "observe"
NOT_OF_A_RECORDED_FILE = {"streamlod_train_seconds", "streamlod_worker_info"}  # there is no training
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("promtool") is None, reason="Prometheus is not installed"),
]


@pytest.fixture
def clip(tmp_path: Path) -> Clip:
    return make_clip(tmp_path / "scene.slod", 60, key_every=20)


@pytest.fixture
def prometheus(tmp_path: Path, clip: Clip) -> Iterator[int]:
    """The port of a Prometheus that reads a server with a viewer, every second."""
    metrics_port, port = free_ports(2)
    text = (OBSERVE / "prometheus.yml").read_text()
    config = tmp_path / "prometheus.yml"
    config.write_text(
        text.replace("scrape_interval: 5s", "scrape_interval: 1s")
        .replace("server:9100", f"127.0.0.1:{metrics_port}")
        .replace(', "gpu:9100"', "")
    )
    settings = tmp_path / "server.toml"
    settings.write_text(f"metrics_port = {metrics_port}\n")
    command = ["prometheus", f"--config.file={config}", f"--storage.tsdb.path={tmp_path / 'tsdb'}"]
    with serving("--play", clip.path, "--state-dir", tmp_path / "state", "--config", settings) as (_, server):
        wait_live(server)
        with live(server) as connection:
            Viewer(connection).hello().until("caught_up")
            with live(server) as turned_away, pytest.raises(ConnectionClosed):
                Viewer(turned_away).hello(levels=0)
            process = subprocess.Popen(
                [*command, f"--web.listen-address=127.0.0.1:{port}"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            try:
                yield port
            finally:
                process.kill()
                process.wait()


def ask(port: int, question: str) -> list[Any]:
    address = f"http://127.0.0.1:{port}/api/v1/query?" + urllib.parse.urlencode({"query": question})
    with urllib.request.urlopen(address, timeout=60) as answer:
        found = json.load(answer)
    assert found["status"] == "success", found
    return list(found["data"]["result"])


def test_the_shipped_configuration_is_valid() -> None:
    subprocess.run(["promtool", "check", "config", str(OBSERVE / "prometheus.yml")], check=True, capture_output=True)


def test_every_panel_of_the_dashboard_shows_something(prometheus: int) -> None:
    panels = json.loads((OBSERVE / "dashboard.json").read_text())["panels"]
    open_questions = {
        target["expr"].replace("$stream", ".*").replace("$node", "127.*")
        for panel in panels
        for target in panel["targets"]
    }
    open_questions = {text for text in open_questions if not any(name in text for name in NOT_OF_A_RECORDED_FILE)}
    assert len(open_questions) >= 12
    limit = time.monotonic() + 60
    while open_questions:
        assert time.monotonic() < limit, open_questions
        time.sleep(1)
        try:
            open_questions = {text for text in open_questions if not ask(prometheus, text)}
        except OSError:
            continue  # it has not started yet
    (live_streams,) = ask(prometheus, "streamlod_live")
    assert live_streams["value"][1] == "1"
