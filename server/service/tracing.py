"""Frames' ways as OpenTelemetry traces, sent to a collector by OTLP over HTTP. Needs the extra `trace`.

Every server derives a frame's trace id from the stream's incarnation and the frame's position, which all servers know.
So the parts of a frame's way that different processes tell belong to one trace, and nothing has to be sent along.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import socket
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import Literal

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import BatchSpanProcessor, SpanExportResult
from opentelemetry.sdk.trace.id_generator import RandomIdGenerator
from opentelemetry.sdk.util.instrumentation import InstrumentationScope
from opentelemetry.trace import SpanContext, TraceFlags
from opentelemetry.util.types import AttributeValue

from streamlod.core.version import streamlod_version
from streamlod.server.stream.traces import FrameStages, Stage, Traces

_LOG = logging.getLogger(__name__)
_EXPORT_SECONDS = 2.0  # after which a collector that does not answer is given up; the end of the server waits for it
_SAMPLED = TraceFlags(TraceFlags.SAMPLED)
_IDS = RandomIdGenerator()
_SCOPE = InstrumentationScope("streamlod", streamlod_version())


@asynccontextmanager
async def tracing(endpoint: str, role: Literal["server", "edge"], traces: Traces) -> AsyncIterator[None]:
    """Send what `traces` tells to the collector at `endpoint` while the context lasts; `role` names this server."""
    address = endpoint.rstrip("/") + "/v1/traces"
    with _kept_out_of_the_log() as faults:
        exporter, (here, worker) = _Exporter(address, faults), _resources(role)
        processor = BatchSpanProcessor(exporter)

        def tell(frame: FrameStages) -> None:
            for span in _spans(frame, here, worker):
                processor.on_end(span)

        traces.listeners.add(tell)
        _LOG.info("traces are sent to %s", address)
        try:
            yield
        finally:
            traces.listeners.discard(tell)
            ending = asyncio.create_task(asyncio.to_thread(processor.shutdown))
            if not (await asyncio.wait({ending}, timeout=_EXPORT_SECONDS))[0]:
                exporter.shutdown()  # type: ignore[no-untyped-call] # batches that are left are not tried one by one
            await ending


class _Faults(logging.Handler):
    """Takes the log of OpenTelemetry's exporter: a line or two for each batch that the collector does not take.

    Attributes:
        first: the first line since it was emptied.
    """

    first = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.first = self.first or record.getMessage()


@contextmanager
def _kept_out_of_the_log() -> Iterator[_Faults]:
    library, faults = logging.getLogger("opentelemetry.exporter"), _Faults()
    library.addHandler(faults)
    library.propagate = False
    try:
        yield faults
    finally:
        library.removeHandler(faults)
        library.propagate = True


class _Exporter(OTLPSpanExporter):
    """Writes one line to the log when the collector begins to take no traces, and one when it takes them again."""

    def __init__(self, address: str, faults: _Faults) -> None:
        super().__init__(address, timeout=_EXPORT_SECONDS)
        self._address, self._faults, self._works = address, faults, True

    def export(self, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        self._faults.first = ""
        result = super().export(spans)
        works = result is SpanExportResult.SUCCESS
        if self._works and not works:
            _LOG.warning("%s takes no traces, which are lost until it does (%.300s)", self._address, self._faults.first)
        if works and not self._works:
            _LOG.info("%s takes traces again", self._address)
        self._works = works
        return result


def _resources(role: str) -> tuple[Resource, Resource]:
    """The processes that do the work: this one, and the worker that makes its frames."""
    about: dict[str, AttributeValue] = {"service.version": streamlod_version()}
    host: dict[str, AttributeValue] = {"host.name": socket.gethostname(), "process.pid": os.getpid()}
    here = Resource({"service.name": f"streamlod-{role}"} | about | host)
    return here, Resource({"service.name": "streamlod-worker"} | about)


def _spans(frame: FrameStages, here: Resource, worker: Resource) -> Iterator[ReadableSpan]:
    """The span of the whole way, where the frame was made `here`, and those of its stages."""
    place = frame.position
    digest = hashlib.sha256(f"{frame.incarnation}/{place.epoch}/{place.version}".encode()).digest()
    trace_id, root_id = int.from_bytes(digest[:16]), int.from_bytes(digest[16:24])
    root = SpanContext(trace_id, root_id, is_remote=not frame.is_origin, trace_flags=_SAMPLED)
    attributes: dict[str, AttributeValue] = {
        "streamlod.stream": frame.stream,
        "streamlod.incarnation": frame.incarnation,
        "streamlod.epoch": place.epoch,
        "streamlod.version": place.version,
    }

    def span(stage: Stage, context: SpanContext, parent: SpanContext | None, resource: Resource) -> ReadableSpan:
        return ReadableSpan(
            stage.name, context, parent, resource, attributes,
            start_time=stage.begin_ns, end_time=stage.end_ns, instrumentation_scope=_SCOPE,
        )  # fmt: skip

    stages = [(each, worker) for each in frame.worker] + [(each, here) for each in frame.server]
    if frame.is_origin:
        begin_ns, end_ns = min(each.begin_ns for each, _ in stages), max(each.end_ns for each, _ in stages)
        yield span(Stage("frame", begin_ns, end_ns), root, None, here)
    for stage, resource in stages:
        context = SpanContext(trace_id, _IDS.generate_span_id(), is_remote=False, trace_flags=_SAMPLED)
        yield span(stage, context, root, resource)
