"""Descriptions of streams that cannot be used, and of those whose publisher is silent."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime

import pytest

pytest.importorskip("nats", reason="nats-py is missing: pip install 'streamlod[jetstream]'")

from streamlod.server.edge.jetstream.connection import NatsConnection
from streamlod.server.edge.jetstream.directory import MAX_REFUSED, SILENT_SECONDS, Directory
from streamlod.server.edge.jetstream.messages import Names
from streamlod.server.settings import Settings


def test_each_stream_is_told_of_once_and_only_so_many_are_kept_in_mind(caplog: pytest.LogCaptureFixture) -> None:
    settings = Settings()
    directory = Directory(NatsConnection(settings.jetstream), Names("streamlod"), settings)
    for body in (b"{", b"{", b"{", b"[]"):
        directory._take("main", body, is_new=True)
    assert [record.args[0] for record in caplog.records] == ["main", "main"]  # two faults  # type: ignore[index]
    for number in range(2 * MAX_REFUSED):
        directory._take(f"stream{number}", b"{", is_new=True)
        directory._take("main", b"[]", is_new=True)  # one that is told again and again stays in mind
    assert len(directory._refused) == MAX_REFUSED
    assert "main" in directory._refused
    assert len(caplog.records) == 2 + 2 * MAX_REFUSED
    directory._take("main", b"", is_new=True)  # it was deleted
    assert "main" not in directory._refused
    assert not directory.streams()


def test_a_stream_whose_publisher_is_silent_is_degraded() -> None:
    settings = Settings()
    directory = Directory(NatsConnection(settings.jetstream), Names("streamlod"), settings)
    description = {"id": "main", "incarnation": "0123456789abcdef", "source": "data", "state": "live"}
    body = json.dumps(description | {"created_at": datetime.now(UTC).isoformat()}).encode()
    directory._take("main", body, is_new=True)
    told = directory._told["main"]
    directory._told["main"] = replace(told, told_at=told.told_at - SILENT_SECONDS - 1)
    assert [stream.state for stream in directory.streams()] == ["degraded"]
