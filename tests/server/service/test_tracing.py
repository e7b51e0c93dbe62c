"""The way of a frame, told by the processes that it passes to one collector."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

pytest.importorskip("opentelemetry.sdk", reason="OpenTelemetry is missing: pip install 'streamlod[trace]'")

from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.app import create_app
from streamlod.server.settings import Settings
from tests.server.conftest import Clip, running, viewing
from tests.server.edge.processes import node
from tests.server.ports import held_ports
from tests.server.service.telling_worker import work
from tests.waiting import wait


@dataclass(frozen=True, slots=True)
class Told:
    """A span, as it came; ids are in hexadecimal."""

    service: str
    pid: int | None
    trace: str
    id: str
    parent: str
    name: str
    version: int
    begin_ns: int
    end_ns: int


@contextmanager
def collector(port: int = 0) -> Iterator[tuple[str, list[Told]]]:
    """An OTLP/HTTP receiver on loopback, at a free port by default: its address, and the spans that have come."""
    told: list[Told] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            assert self.path == "/v1/traces"
            told.extend(spans_in(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", port), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", told
        finally:
            server.shutdown()
            thread.join()


def spans_in(body: bytes) -> Iterator[Told]:
    for group in ExportTraceServiceRequest.FromString(body).resource_spans:
        about = {each.key: each.value for each in group.resource.attributes}
        pid = about["process.pid"].int_value if "process.pid" in about else None
        for span in (span for scope in group.scope_spans for span in scope.spans):
            version = next(each.value.int_value for each in span.attributes if each.key == "streamlod.version")
            yield Told(
                about["service.name"].string_value, pid, span.trace_id.hex(), span.span_id.hex(),
                span.parent_span_id.hex(), span.name, version, span.start_time_unix_nano, span.end_time_unix_nano,
            )  # fmt: skip


def of_one_frame(told: list[Told], *names: tuple[str, str]) -> list[Told]:
    """The spans of a trace that has all these (service and name); none while there is no such trace."""
    traces: dict[str, list[Told]] = {}
    for span in list(told):
        traces.setdefault(span.trace, []).append(span)
    wanted = set(names)
    return next((found for found in traces.values() if wanted <= {(each.service, each.name) for each in found}), [])


@pytest.mark.cluster
def test_two_servers_tell_the_way_of_a_frame_as_one_trace(clip: Clip, tmp_path: Path) -> None:
    soon = {"OTEL_BSP_SCHEDULE_DELAY": "200"}  # milliseconds
    with ExitStack() as stack:
        address, told = stack.enter_context(collector())
        to = ("--trace-endpoint", address)
        origin = stack.enter_context(node(tmp_path, "serve", "--play", clip.path, *to, **soon))
        edge = stack.enter_context(node(tmp_path, "edge", "--origin", origin.url, *to, **soon))
        wait(lambda: edge.get("/v1/streams/main").status_code == 200)
        with edge.viewing() as viewer:
            viewer.hello().until("caught_up")
            for _ in range(20):
                viewer.next_packet()
            names = ("streamlod-server", "frame"), ("streamlod-server", "send"), ("streamlod-edge", "send")
            found = wait(lambda: viewer.step() and of_one_frame(told, *names))
    assert {span.pid for span in found} == {origin.process.pid, edge.process.pid}
    assert len({span.version for span in found}) == 1
    (root,) = [span for span in found if span.name == "frame"]
    assert root.parent == ""
    assert {span.parent for span in found if span is not root} == {root.id}
    sent = [next(span for span in found if (span.service, span.name) == name) for name in names[1:]]
    assert root.begin_ns <= sent[0].begin_ns <= sent[0].end_ns == root.end_ns
    assert sent[0].begin_ns < sent[1].end_ns  # by one clock here
    assert len({span.id for span in told}) == len(told)


def test_what_a_worker_did_to_a_frame_is_in_the_frames_trace(clip: Clip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("streamlod.server.worker.supervisor.run_worker", work)
    monkeypatch.setattr(
        "streamlod.server.service.tracing._EXPORT_SECONDS", 30.0
    )  # the end waits until all 700 spans are sent
    with (
        collector() as (address, told),
        running(Settings(trace_endpoint=address), StreamSpec(play=clip.path)) as server,
    ):
        assert server.wait(lambda stream: stream["state"] == "ended", seconds=60)["report"] == {"version": 99}
    frames = {span.version: span for span in told if span.name == "frame"}
    assert frames.keys() == set(range(100))
    for version, frame in frames.items():
        stages = sorted((span for span in told if span.parent == frame.id), key=lambda span: span.begin_ns)
        assert [span.name for span in stages] == ["ingest", "train", "encode", "decode", "retain", "send"]
        assert [span.service for span in stages] == ["streamlod-worker"] * 3 + ["streamlod-server"] * 3
        assert {(span.trace, span.version) for span in stages} == {(frame.trace, version)}
        assert (frame.begin_ns, frame.end_ns) == (stages[0].begin_ns, stages[-1].end_ns)


@pytest.mark.long
def test_a_collector_that_does_not_answer_holds_nothing_up_and_is_told_of_once(
    clip: Clip, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("OTEL_BSP_SCHEDULE_DELAY", "50")
    spec = StreamSpec(play=clip.path, loop=True)

    def lines(text: str) -> list[str]:
        return [record.getMessage() for record in caplog.records if text in record.getMessage()]

    with (
        held_ports(1) as (port,),
        ExitStack() as later,
        caplog.at_level("INFO"),
        running(Settings(trace_endpoint=f"http://127.0.0.1:{port}"), spec) as server,
        viewing(server, max_queue=None) as viewer,
    ):
        viewer.hello().until("caught_up")
        wait(lambda: viewer.step() and lines("takes no traces"))
        begun = time.monotonic()
        while time.monotonic() < begun + 3:  # further attempts fail
            viewer.next_packet()
        later.enter_context(collector(port))
        wait(lambda: viewer.step() and lines("takes traces again"))
    (line,) = lines("takes no traces")
    assert "refused" in line  # why
    assert len(lines("takes traces again")) == 1
    assert not [record for record in caplog.records if record.name.startswith("opentelemetry")]
    assert logging.getLogger("opentelemetry").propagate


def test_without_a_collector_nobody_listens() -> None:
    assert not create_app(Settings()).state.registry.traces.listeners
