"""A server that is to share streams, where nats-py is not installed."""

from __future__ import annotations

import sys

import pytest

from core.errors import BackendUnavailable, InputError
from server.service.app import create_app
from server.settings import EdgeSettings, Settings


def test_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [
        name for name in sys.modules if name.split(".")[0] == "nats" or name.startswith("server.edge.jetstream")
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nats", None)
    with pytest.raises(BackendUnavailable, match=r"streamlod\[jetstream\]"):
        create_app(Settings(bus="jetstream"))


def test_without_the_setting_nothing_of_it_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nats", None)
    create_app(Settings())


def test_an_edge_has_no_other_source() -> None:
    with pytest.raises(InputError, match="leave out `bus`"):
        Settings(bus="jetstream", edge=EdgeSettings(origin="http://127.0.0.1:8000")).check()
