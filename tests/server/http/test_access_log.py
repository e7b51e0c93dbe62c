"""The log of requests, and the log as JSON."""

from __future__ import annotations

import json
import logging
import sys

import pytest

from streamlod.core.background_log import JsonFormatter
from streamlod.server.http.access_log import ACCESS
from streamlod.server.settings import Settings
from tests.server.conftest import running


def test_every_request_is_a_line_without_its_query(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, ACCESS)
    with running(Settings(access_log=True)) as server, server.client() as client:
        size = len(client.get("/healthz").content)
        client.get("/v1/streams/none/bitstream?signature=secret")
    lines = [json.loads(JsonFormatter().format(record)) for record in caplog.records if record.name == ACCESS]
    assert [(line["method"], line["path"], line["status"]) for line in lines] == [
        ("GET", "/healthz", 200),
        ("GET", "/v1/streams/none/bitstream", 401),
    ]
    assert lines[0]["bytes"] == size
    assert lines[0]["address"] == "127.0.0.1"
    assert "secret" not in caplog.text


def test_without_the_setting_there_is_none(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, ACCESS)
    with running(Settings()) as server, server.client() as client:
        client.get("/healthz")
    assert ACCESS not in {record.name for record in caplog.records}


def test_a_json_line_holds_one_record_whatever_is_in_it() -> None:
    try:
        raise ValueError("two\nlines")
    except ValueError:
        record = logging.LogRecord("a", logging.ERROR, "f", 1, "said %s", ("x\ny",), sys.exc_info())
    line = JsonFormatter().format(record)
    assert "\n" not in line
    found = json.loads(line)
    assert (found["level"], found["logger"], found["message"]) == ("ERROR", "a", "said x\ny")
    assert "two\nlines" in found["error"]
    assert found["time"].endswith("+00:00")
