"""The application: routes, errors, the page."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from starlette.exceptions import HTTPException

from streamlod.core.errors import BackendUnavailable
from streamlod.core.field_faults import first_fault
from streamlod.core.masking import masked
from streamlod.core.options import TOKEN_VARIABLE
from streamlod.server.api import downloads, events, live, poster, push, recordings, server_info, streams, viewers
from streamlod.server.api.access import grant_of, need, registry_of
from streamlod.server.api.hls import routes as hls
from streamlod.server.api.registry import Registry
from streamlod.server.api.schemas import Health
from streamlod.server.auth.gate import Right
from streamlod.server.edge import passing
from streamlod.server.edge.edge import Edge
from streamlod.server.edge.origin import Origin
from streamlod.server.edge.pull import OriginSource
from streamlod.server.http.access_log import AccessLog
from streamlod.server.http.head import HeadAsGet
from streamlod.server.http.networks import check_places
from streamlod.server.http.problems import Problem, not_found_page, problem_response, problems
from streamlod.server.http.site_policy import SitePolicy
from streamlod.server.http.static_page import PageFiles
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.service.docs_page import add_docs
from streamlod.server.service.metrics import collector_registry
from streamlod.server.service.openapi import describe
from streamlod.server.service.webhooks import Webhooks
from streamlod.server.settings import Settings
from streamlod.server.stream.traces import Traces

if TYPE_CHECKING:
    from streamlod.server.edge.jetstream.node import JetStream

POLL_SECONDS = 0.5  # between two looks at which streams other servers share

_DESCRIPTION = """
Live free-viewpoint video. Streams are watched over the websocket `/v1/streams/{id}/live` (docs/protocol.md);
this interface lists and controls them and serves what was recorded.
"""
_STATUS_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>streamlod</title>
<style>body{font:16px system-ui;margin:2em;max-width:50em}td{padding:.2em 1em .2em 0}</style>
<h1>streamlod</h1><table id="t"></table><p><a href="/docs">REST interface</a></p>
<script>
async function show() {
  const answer = await fetch('/v1/streams'); const list = await answer.json();
  document.getElementById('t').replaceChildren(...list.items.map(s => {
    const row = document.createElement('tr');
    for (const text of [s.id, s.state, s.detail, 'frame ' + (s.version ?? '-'), s.viewers + ' viewers'])
      row.appendChild(document.createElement('td')).textContent = text;
    return row; }));
}
show(); setInterval(show, 2000);
</script></html>"""


def create_app(settings: Settings, specs: tuple[StreamSpec, ...] = ()) -> FastAPI:
    """The application with its streams, which start with its lifespan.

    Raises:
        InputError: tokens, state folder or streams cannot be used.
        BackendUnavailable: a package that a setting needs is missing.
    """
    if settings.jobs == "ray" and importlib.util.find_spec("ray") is None:
        raise BackendUnavailable("jobs ray", "install it: pip install 'streamlod[ray]'")
    check_places(settings)
    shared = _shared(settings)
    registry = Registry(settings, specs, None if shared is None else shared.outbox)
    traced = _traced(settings, registry.traces)
    origin = None if settings.edge is None else Origin(settings.edge.origin, os.environ.get(TOKEN_VARIABLE))

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with _delivering(registry), traced, shared or nullcontext():
            registry.start()
            if origin is not None and settings.edge is not None:
                edge = settings.edge
                source = OriginSource(origin, edge.streams, settings)
                registry.spawn(Edge(registry, source, edge.poll_seconds, edge.linger_seconds).run())
            if shared is not None:
                registry.spawn(Edge(registry, shared, POLL_SECONDS, settings.jetstream.linger_seconds).run())
            yield
            await registry.drain()

    app = FastAPI(
        title="streamlod", version="1", description=_DESCRIPTION, lifespan=lifespan, docs_url=None, redoc_url=None,
        generate_unique_id_function=lambda route: route.name,  # the function's, which stays when paths change
    )  # fmt: skip
    app.state.registry, app.state.posters, app.state.origin = registry, poster.Posters(), origin
    app.state.segment_numbers = WeakKeyDictionary()  # of each stream, as its playlists have named them
    app.openapi = lambda: describe(app, needs_tokens=settings.has_tokens)  # type: ignore[method-assign]
    _add_errors(app)
    app.include_router(live.router)
    app.include_router(streams.router)
    for part in (downloads, viewers, events, server_info, poster):
        app.include_router(part.router)
    if origin is None:
        for router in (downloads.played, hls.router, push.router, streams.control, recordings.router):
            app.include_router(router)
    else:  # its streams are made, controlled and recorded at the origin
        app.include_router(passing.router)
    _add_health(app)
    add_docs(app)
    _add_page(app)

    app.add_middleware(HeadAsGet)
    app.add_middleware(SitePolicy, settings=settings)
    if settings.access_log:
        app.add_middleware(AccessLog)
    return app


def _shared(settings: Settings) -> JetStream | None:
    """The streams that this server shares with others, if it does.

    Raises:
        BackendUnavailable: nats-py is missing.
    """
    if settings.bus == "local":
        return None
    try:
        from streamlod.server.edge.jetstream.node import JetStream
    except ImportError as error:
        raise BackendUnavailable("bus jetstream", "install it: pip install 'streamlod[jetstream]'") from error
    return JetStream(settings)


def _traced(settings: Settings, traces: Traces) -> AbstractAsyncContextManager[None]:
    """Sends traces while it lasts, if they are wanted.

    Raises:
        BackendUnavailable: OpenTelemetry is missing.
    """
    if settings.trace_endpoint is None:
        return nullcontext()
    try:
        from streamlod.server.service.tracing import tracing
    except ImportError as error:
        raise BackendUnavailable("trace_endpoint", "install it: pip install 'streamlod[trace]'") from error
    return tracing(settings.trace_endpoint, "edge" if settings.edge else "server", traces)


@asynccontextmanager
async def _delivering(registry: Registry) -> AsyncIterator[None]:
    """Deliver to webhooks; other ones, and other limits, once the settings have changed."""
    hooks = Webhooks(registry.feed)
    hooks.use(registry.settings)
    registry.on_change = hooks.use
    try:
        yield
    finally:
        await hooks.close()


def _add_errors(app: FastAPI) -> None:
    @app.exception_handler(Problem)
    async def problem(_: Request, error: Problem) -> Response:
        return problem_response(error.status, error.detail, error.headers)

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        if error.status_code in {404, 405}:
            allowed = _allowed(app, request.url.path)
            if allowed and request.method not in allowed:  # the page's files lie behind and know of no other methods
                return problem_response(405, "this address takes other methods", {"Allow": ", ".join(allowed)})
            detail = f"there is nothing at {request.url.path[:200]}"
            if request.url.path.startswith("/v1/"):
                return problem_response(404, detail)
            if error.status_code == 405:
                return problem_response(405, "this address takes other methods", dict(error.headers or {}))
            wants_page = "text/html" in request.headers.get("accept", "")
            return not_found_page(detail) if wants_page else problem_response(404, detail)
        if error.status_code == 400:  # of the framework alone, which could not read the body
            return problem_response(400, "the body is no JSON, or not in UTF-8, or nested too deeply")
        return problem_response(error.status_code, str(error.detail), dict(error.headers or {}))

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
        if first["loc"][0] == "body" and kind not in {"", "application/json"} and not kind.endswith("+json"):
            return problem_response(415, "a body has the type application/json")
        if first["type"] == "json_invalid":
            return problem_response(
                400, f"the body is no JSON ({first['ctx']['error']} at character {first['loc'][1]})"
            )
        place, fault = first_fault(error.errors(), skip=1)
        return problem_response(422, masked(f"{place or 'the body'}: {fault}"))


def _allowed(app: FastAPI, path: str) -> list[str]:
    """Methods that a path of the interface takes, of all its routes together."""
    found: set[str] = set()
    for template, operations in app.openapi()["paths"].items():
        if re.fullmatch(re.sub(r"\{[^}]+\}", "[^/]+", template), path):
            found |= {method.upper() for method in operations}
    return sorted(found | ({"HEAD"} if "GET" in found else set()))


def _add_health(app: FastAPI) -> None:
    @app.get("/healthz", tags=["health"], summary="Whether the process works")
    async def healthz() -> Health:
        """Always 200 while the process answers."""
        return Health(status="ok")

    @app.get("/readyz", tags=["health"], summary="Whether viewers may come", responses={503: {"model": Health}})
    async def readyz(request: Request, response: Response) -> Health:
        """503 while stopping, and while the disk of the recordings is full. Streams have a readiness of their own."""
        registry = registry_of(request)
        detail = registry.unready
        if registry.draining:
            detail = "the server is stopping"
        elif registry.store is not None and not registry.store.disk.has_room:
            detail = "the disk is full except for its reserve"
        response.status_code = 503 if detail else 200
        return Health(status="not ready" if detail else "ok", detail=detail)

    @app.get(
        "/metrics",
        tags=["health"],
        summary="Prometheus metrics",
        dependencies=[need(Right.METRICS)],
        response_class=PlainTextResponse,
        responses=problems(401, 403, 429),
    )
    async def metrics(request: Request) -> PlainTextResponse:
        """The same as on the port of the metrics, for those with the right."""
        text = generate_latest(collector_registry(registry_of(request), grant_of(request)))
        return PlainTextResponse(text, media_type=CONTENT_TYPE_LATEST)


def _add_page(app: FastAPI) -> None:
    folder = _page_folder()
    if folder is not None:
        app.mount("/", PageFiles(directory=folder, html=True), name="page")
        return

    @app.get("/", include_in_schema=False)
    async def status() -> HTMLResponse:
        return HTMLResponse(_STATUS_PAGE)


def _page_folder() -> Path | None:
    """The viewer page, if its package is installed; found without importing it."""
    package = importlib.util.find_spec("streamlod.client")
    for place in (package.submodule_search_locations or []) if package else []:
        folder = Path(place) / "web"
        if (folder / "index.html").is_file():
            return folder
    return None
