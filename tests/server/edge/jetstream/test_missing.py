"""A server that is to share streams, where nats-py is not installed."""

from __future__ import annotations

import subprocess
import sys

import pytest

from streamlod.core.errors import InputError
from streamlod.server.service.app import create_app
from streamlod.server.settings import EdgeSettings, Settings

WITHOUT_NATS = """
import sys
sys.modules["nats"] = None
from streamlod.core.errors import BackendUnavailable
from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings
try:
    create_app(Settings(bus="jetstream"))
except BackendUnavailable as error:
    print(error)
"""


def test_it_says_what_to_install() -> None:
    """In a process of its own: packages of this one that were loaded keep their modules."""
    result = subprocess.run([sys.executable, "-c", WITHOUT_NATS], capture_output=True, text=True, check=True)
    assert "streamlod[jetstream]" in result.stdout


def test_without_the_setting_nothing_of_it_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nats", None)
    create_app(Settings())


def test_an_edge_has_no_other_source() -> None:
    with pytest.raises(InputError, match="leave out `bus`"):
        Settings(bus="jetstream", edge=EdgeSettings(origin="http://127.0.0.1:8000")).check()
