"""The OpenAPI document against the real server, by schemathesis: generated requests, valid and not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.server.conftest import Clip, Running, running

SCHEMATHESIS = Path(sys.executable).with_name("schemathesis")
REFUSALS = [400, 401, 403, 404, 405, 406, 409, 412, 413, 415, 422, 428, 429]  # with `If-Match` that comes first
pytestmark = pytest.mark.skipif(
    not SCHEMATHESIS.exists(), reason="schemathesis is not installed: pip install schemathesis"
)


@pytest.fixture
def server(clip: Clip, tmp_path: Path) -> Iterator[Running]:
    settings = Settings(state=tmp_path / "state", limits=Limits(streams=4))
    with running(settings, StreamSpec(play=clip.path)) as server:
        server.wait(lambda stream: stream["state"] == "live")
        yield server


def run(server: Running, folder: Path, *options: str) -> None:
    """Run schemathesis. What makes a stream's data usable lies on the server's disk, which no schema can say; and data
    sets that would be trained are left out."""
    command = [
        str(SCHEMATHESIS), "run", f"{server.url}/openapi.json",
        "--exclude-checks", "positive_data_acceptance", "--request-timeout", "10", "--seed", "7", "--no-color",
        "--max-failures", "10", "--exclude-path", "/v1/streams/{stream_id}/ready",  # 503 is an answer there
        "--exclude-path", "/v1/events", *options,  # which has no end
    ]  # fmt: skip
    (folder / "schemathesis.toml").write_text(f"[checks.negative_data_rejection]\nexpected-statuses = {REFUSALS}\n")
    found = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert found.returncode == 0, found.stdout[-6000:] + found.stderr[-1000:]
    with server.client() as client:
        assert client.get("/healthz").status_code == 200


@pytest.mark.long
def test_the_interface_is_as_described(server: Running, tmp_path: Path) -> None:
    run(server, tmp_path, "--phases", "fuzzing", "--max-examples", "3")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_interface_is_as_described_in_all_phases(server: Running, tmp_path: Path) -> None:
    run(server, tmp_path, "--max-examples", "30")
