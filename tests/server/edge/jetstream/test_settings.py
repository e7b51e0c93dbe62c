"""A server that is to share streams, and its settings."""

from __future__ import annotations

import pytest

from streamlod.core.errors import InputError
from streamlod.server.settings import EdgeSettings, Settings


def test_an_edge_has_no_other_source() -> None:
    with pytest.raises(InputError, match="leave out `bus`"):
        Settings(bus="jetstream", edge=EdgeSettings(origin="http://127.0.0.1:8000")).check()
