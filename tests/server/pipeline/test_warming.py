"""Warming takes the path that streams take; it checks itself that decoding gives what was encoded."""

from __future__ import annotations

import pytest

from core.errors import InputError
from server.pipeline.rehearsal import rehearse
from server.pipeline.warming import warm_codec


def test_warming_encodes_and_decodes() -> None:
    warm_codec()


def test_rehearsing_trains_and_refuses_what_training_would() -> None:
    rehearse("live", "cpu")
    with pytest.raises(InputError, match="preset"):
        rehearse("no such preset", "cpu")
