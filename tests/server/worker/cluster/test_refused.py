"""What callers are told when the cluster has no room: other streams by name only if they may see them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="ray is missing: pip install 'streamlod[ray]'")

from streamlod.server.settings import Settings, WorkerSettings
from tests.server.conftest import running
from tests.server.worker.cluster.no_room import find_no_room

RIGHTS = ["read", "control"]


def test_a_refusal_names_only_streams_that_the_caller_may_see(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.stream.worker_stream.run_on_ray", find_no_room)
    holders = {"stage": "stage-*", "all": "*"}
    tokens = tmp_path / "tokens.json"
    tokens.write_text(json.dumps([
        {"name": name, "sha256": hashlib.sha256(name.encode()).hexdigest(), "rights": RIGHTS, "streams": streams}
        for name, streams in holders.items()
    ]))  # fmt: skip
    settings = Settings(jobs="ray", tokens=tokens, worker=WorkerSettings(spare=False))
    new = {"id": "stage-2", "synthetic": {"frames": 1}}
    with running(settings) as server, server.client(timeout=60) as client:
        as_stage, as_all = ({"Authorization": f"Bearer {name}"} for name in holders)
        refused = client.post("/v1/streams", json=new | {"start": True}, headers=as_stage)
        assert (refused.status_code, refused.json()["detail"]) == (409, "stream stage-2: it needs 1 CPU; stop stage-1")
        assert client.post("/v1/streams", json=new, headers=as_stage).status_code == 201
        refused = client.post("/v1/streams/stage-2/start", headers=as_all)
        assert refused.json()["detail"] == "stream stage-2: it needs 1 CPU; stop secret, or stage-1"
        shown = client.get("/v1/streams/stage-2", headers=as_stage)
        assert shown.json()["state"] == "failed"
        assert "secret" not in shown.text
