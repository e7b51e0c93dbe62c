"""Who may film, by token or by link, and what the page says to all others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from streamlod.server.auth.gate import hash_token
from streamlod.server.settings import Settings
from tests.client.web.phones import opened, says
from tests.server.ingest.push.stage import HEIGHT, WIDTH, rig, stage

pytestmark = pytest.mark.browser


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("?stream=main", "does not take pictures from here: a valid token is needed."),
        ("?stream=main&token=reader", "does not take pictures from here: the token does not give the right to publish"),
        ("?stream=other&token=nodes", "does not take pictures from here: there is no such stream."),
    ],
)
def test_who_may_not_film_is_told_why(phone: Any, tmp_path: Path, query: str, sentence: str) -> None:
    with stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 2), "all") as found:
        with opened(phone, f"{found.server.url}/capture{query}") as page:
            says(page, sentence)
            assert page.is_disabled("#film")
        assert found.got == []


def test_a_phone_whose_token_runs_out_stops_its_camera(
    phone: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says what to do, and does not try again, as each attempt would count against its address."""
    monkeypatch.setattr("streamlod.server.api.access.RECHECK_SECONDS", 0.2)
    with (
        stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 1), "all") as found,
        opened(phone, found.page("&token=nodes")) as page,
    ):
        says(page, "Ready to film")
        page.click("#film")
        found.wait(3)
        (tmp_path / "tokens.json").write_text("[]")
        found.server.registry.gate.reload()
        says(page, "the token has expired or was withdrawn; connect with another. Open this page by a link with")
        page.wait_for_function("document.getElementById('picture').srcObject.getTracks()[0].readyState === 'ended'")
        assert page.is_disabled("#film")
        assert not page.is_visible("#picture")
        assert found.server.registry.gate.refused == 0


def test_a_link_is_good_for_one_camera(phone: Any, tmp_path: Path) -> None:
    """It needs no token, and offers no other name."""
    with stage(guarded(tmp_path), rig((WIDTH, HEIGHT), 2), "all") as found:
        with found.server.client(headers={"Authorization": "Bearer all"}) as client:
            link = client.post("/v1/streams/main/links", json={"path": "ingest/phone2"}).json()["url"]
        with opened(phone, found.server.url + link) as page:
            says(page, "Ready to film")
            assert page.eval_on_selector_all("#name option", "(all) => all.map((e) => e.value)") == ["phone2"]
            page.click("#film")
            assert [list(frame.present) for frame in found.wait(3)] == [[False, True]] * 3


def guarded(folder: Path) -> Settings:
    """Settings with tokens: one for everything, one that reads, one of capture nodes."""
    rights = {"all": ["read", "publish", "control"], "reader": ["read"], "nodes": ["publish"]}
    file = folder / "tokens.json"
    entries = [
        {"name": name, "sha256": hash_token(name), "rights": given, "streams": "*"} for name, given in rights.items()
    ]
    file.write_text(json.dumps(entries))
    return Settings(tokens=file)
