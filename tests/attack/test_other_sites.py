"""Pages of other sites in the browser of somebody who may reach the server."""

from __future__ import annotations

from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus

from streamlod.core.errors import InputError
from streamlod.server.settings import Settings
from tests.server.conftest import UNWATCHED, running, viewing

_STAGE = "https://stage.example"
_PATHS = ("/v1/streams", "/v1/streams/main/bitstream", "/openapi.json", "/", "/healthz", "/metrics")


def test_a_name_that_was_made_to_lead_here_reads_nothing() -> None:
    with running(Settings(), UNWATCHED) as server, server.client(headers={"Host": "rebound.example"}) as client:
        for path in _PATHS:
            answer = client.get(path)
            assert answer.status_code == 421, path
            assert answer.headers["content-type"] == "application/problem+json"
        rebound = {"additional_headers": {"Host": "rebound.example"}}
        with pytest.raises(InvalidStatus), viewing(server, **rebound):
            pass


@pytest.mark.parametrize("settings", [Settings(hosts=("stage.example",)), Settings(origins=(_STAGE,))])
def test_listed_names_are_answered(settings: Settings) -> None:
    with running(settings, UNWATCHED) as server, server.client(headers={"Host": "Stage.example:443"}) as client:
        assert client.get("/v1/streams").status_code == 200


def test_with_tokens_only_listed_names_count_where_some_are_listed(tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text("[]")
    for hosts, status in (((), 200), (("stage.example",), 421)):
        with running(Settings(tokens=tokens, hosts=hosts), UNWATCHED) as server, server.client() as client:
            assert client.get("/healthz", headers={"Host": "other.example"}).status_code == status


def test_listed_origins_read_answers_and_others_do_not() -> None:
    with running(Settings(origins=(_STAGE,)), UNWATCHED) as server, server.client() as client:
        known = client.get("/v1/streams", headers={"Origin": _STAGE})
        assert known.headers["access-control-allow-origin"] == _STAGE
        assert "etag" in known.headers["access-control-expose-headers"].lower()
        assert (
            "access-control-allow-origin"
            not in client.get("/v1/streams", headers={"Origin": "https://x.example"}).headers
        )
        asked = {"Access-Control-Request-Method": "DELETE", "Access-Control-Request-Headers": "authorization"}
        assert client.options("/v1/streams/main", headers={"Origin": _STAGE, **asked}).status_code == 200
        assert client.options("/v1/streams/main", headers={"Origin": "https://x.example", **asked}).status_code == 400


def test_only_listed_sites_may_frame_the_page() -> None:
    with running(Settings(), UNWATCHED) as server, server.client() as client:
        headers = client.get("/").headers
        assert headers["content-security-policy"] == "frame-ancestors 'self'"
        assert headers["x-frame-options"] == "SAMEORIGIN"
    with running(Settings(frame_ancestors=(_STAGE,)), UNWATCHED) as server, server.client() as client:
        headers = client.get("/").headers
        assert headers["content-security-policy"] == f"frame-ancestors 'self' {_STAGE}"
        assert "x-frame-options" not in headers


@pytest.mark.parametrize("origin", ["stage.example", "https://stage.example/path", "https://a; script-src *", ""])
def test_an_origin_that_is_none_is_refused(origin: str) -> None:
    for field in ("origins", "frame_ancestors"):
        with pytest.raises(InputError, match="is not an origin"):
            Settings.model_validate({field: [origin]}).check()
