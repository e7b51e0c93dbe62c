"""Tokens that see more than they should, or outlive themselves."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import jwt
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from streamlod.server.api.access import admit
from streamlod.server.auth.gate import Right, hash_token
from streamlod.server.ingest.push.router import push_router
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.settings import Limits, Settings
from tests.server.conftest import UNWATCHED, Clip, running, viewing
from tests.waiting import wait

_SECRET = "s" * 40
_STREAMS = tuple(replace(UNWATCHED, id=name) for name in ("stage-1", "stage-2", "office"))


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def write_tokens(path: Path, **grants: dict[str, Any]) -> Settings:
    """Settings with static tokens, called by their names, and JSON web tokens signed with `_SECRET`."""
    entries = [{"name": name, "sha256": hash_token(name), **grant} for name, grant in grants.items()]
    (path / "tokens.json").write_text(json.dumps(entries))
    (path / "key").write_text(_SECRET)
    return Settings(tokens=path / "tokens.json", jwt_key=path / "key")


def web_token(seconds: float, *rights: str) -> str:
    claims = {"exp": time.time() + seconds, "aud": "streamlod", "lod": {"rights": list(rights)}}
    return jwt.encode(claims, _SECRET, "HS256")


def close_code(closed: Callable[[], Any]) -> int:
    """With which the server closes a connection that calls `closed` again and again."""
    with pytest.raises(ConnectionClosed) as caught:
        _for_ever(closed)
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code


def _for_ever(work: Callable[[], Any]) -> None:
    while True:
        work()


def test_a_token_for_some_streams_sees_nothing_of_others(tmp_path: Path) -> None:
    settings = write_tokens(tmp_path, stage={"rights": ["read", "metrics", "control"], "streams": "stage-*"})
    with running(settings, *_STREAMS) as server, server.client(headers=bearer("stage")) as client:
        page = client.get("/v1/streams", params={"limit": 1}).json()
        assert [page["items"][0]["id"], page["next_cursor"]] == ["stage-1", "stage-1"]
        assert [stream["id"] for stream in client.get("/v1/streams").json()["items"]] == ["stage-1", "stage-2"]
        metrics = client.get("/metrics").text
        assert 'stream="stage-2"' in metrics
        assert "office" not in metrics
        assert "streamlod_refused_tokens" not in metrics
        missing, hidden = (client.get(f"/v1/streams/{name}") for name in ("nobody", "office"))
        assert missing.status_code == hidden.status_code == 403
        assert missing.json() == hidden.json()


def test_who_shares_an_address_with_wrong_tokens_is_let_in_a_minute_later(tmp_path: Path, clip: Clip) -> None:
    """Until then viewers and phones are told to come again: 4401 would end their pages for good."""
    settings = write_tokens(tmp_path, right={"rights": ["read", "publish"]})
    settings = settings.model_copy(update={"limits": Limits(refusals_per_minute=1)})
    with running(settings, StreamSpec(play=clip.path)) as server, server.client(headers=bearer("wrong")) as client:
        assert client.get("/v1/streams").status_code == 401
        with viewing(server, additional_headers=bearer("right")) as viewer:
            assert close_code(viewer.hello) == 1013
        server.registry.gate.limit_refusals(2)  # the one that was counted is fewer
        with viewing(server, additional_headers=bearer("right")) as viewer:
            viewer.hello()
            viewer.next_packet()


@pytest.mark.long
@pytest.mark.parametrize("change", ["withdrawn", "expired", "fewer rights"])
def test_a_viewer_whose_token_ends_is_closed(
    tmp_path: Path, clip: Clip, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("streamlod.server.api.access.RECHECK_SECONDS", 0.2)
    settings = write_tokens(tmp_path, viewer={"rights": ["read"]})
    with ExitStack() as stack:
        server = stack.enter_context(running(settings, StreamSpec(play=clip.path)))
        wait(lambda: server.registry.streams["main"].state == "live")
        token = web_token(-25, "read") if change == "expired" else "viewer"  # half a minute of leeway
        viewer = stack.enter_context(viewing(server, additional_headers=bearer(token)))
        viewer.hello()
        viewer.next_packet()
        if change != "expired":
            write_tokens(tmp_path, **({"viewer": {"rights": ["metrics"]}} if change == "fewer rights" else {}))
            server.registry.gate.reload()
        assert close_code(viewer.step) == (4403 if change == "fewer rights" else 4401)


@pytest.mark.long
def test_a_capture_node_whose_token_ends_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from streamlod.server.api import push

    class Intake:
        def accept(self, _: object) -> None: ...
        def close(self) -> None: ...

    async def opened(websocket: Any, stream_id: str) -> Intake:
        await admit(websocket, Right.PUBLISH, stream_id)
        return Intake()

    monkeypatch.setattr("streamlod.server.api.access.RECHECK_SECONDS", 0.2)
    monkeypatch.setattr("streamlod.server.api.push.router", push_router(opened, push.until_no_publisher))
    with ExitStack() as stack:
        server = stack.enter_context(running(write_tokens(tmp_path), *_STREAMS))
        address = f"ws://127.0.0.1:{server.port}/v1/streams/stage-1/ingest"
        options: Any = {"subprotocols": ["streamlod.push.v1"], "proxy": None}
        headers = bearer(web_token(-26, "publish"))
        node = stack.enter_context(connect(address, additional_headers=headers, **options))
        assert close_code(node.recv) == 4401


def test_a_link_ends_with_the_token_that_asked_for_it(tmp_path: Path) -> None:
    with running(write_tokens(tmp_path), *_STREAMS) as server:
        token = web_token(100, "read")
        expires = int(jwt.decode(token, _SECRET, ["HS256"], audience="streamlod")["exp"])
        with server.client(headers=bearer(token)) as client:
            link = client.post("/v1/streams/stage-1/links", json={"seconds": 3600}).json()
            assert f"expires={expires}&" in link["query"]
            short = client.post("/v1/streams/stage-1/links", json={"seconds": 5}).json()
            assert int(short["query"].split("expires=")[1].split("&")[0]) <= time.time() + 5
