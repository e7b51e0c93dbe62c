"""Warming takes the path that streams take; it checks itself that decoding gives what was encoded."""

from __future__ import annotations

from server.warming import warm_codec


def test_warming_encodes_and_decodes() -> None:
    warm_codec()
