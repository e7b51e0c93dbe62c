"""Running the server as a process: sockets, signals, metrics, shutdown."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType
from wsgiref.simple_server import WSGIRequestHandler, make_server

import uvicorn
from fastapi import FastAPI
from prometheus_client import make_wsgi_app
from prometheus_client.exposition import ThreadingWSGIServer

from streamlod.core.background_log import LOG_FORMAT_VARIABLE, log_in_background
from streamlod.core.errors import InputError, StreamlodError
from streamlod.server.api.registry import Registry
from streamlod.server.http.limits import http_class
from streamlod.server.http.networks import check_places
from streamlod.server.http.tls import Certificates, Handshakes, TlsListener
from streamlod.server.http.websocket import websocket_class
from streamlod.server.pipeline.spec import StreamSpec
from streamlod.server.pipeline.warming import warm_codec
from streamlod.server.service.addresses import found_at, is_everywhere
from streamlod.server.service.app import create_app
from streamlod.server.service.memory import bound_arenas, leave_out_linear_algebra, page_out_compiler
from streamlod.server.service.metrics import collector_registry
from streamlod.server.settings import Settings

_LOG = logging.getLogger(__name__)
_BACKLOG = 2048
KEEP_ALIVE_SECONDS = 15  # that a connection may be silent between two requests
_GOODBYE_SECONDS = 0.5  # that closed connections have to end when the server stops
_OTHER_DESCRIPTORS = 512  # of files, pipes and databases


class Server(uvicorn.Server):
    """uvicorn, which disconnects viewers before connections are closed.

    Args:
        config: of `server_config`.
        registry: of its application.
        certificates: with which it serves by TLS.
    """

    def __init__(self, config: uvicorn.Config, registry: Registry, certificates: Certificates | None = None) -> None:
        super().__init__(config)
        self._registry, self._certificates = registry, certificates
        self._listener: TlsListener | None = None
        self._accepting: list[asyncio.Task[None]] = []
        self._handshakes = Handshakes(registry.settings.limits, registry.turned_away)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        if self._certificates is None:
            await super().startup(sockets)
            return
        await super().startup([])
        self._listener = TlsListener(self._certificates, self._handshakes, self._protocol)
        self._accepting = [asyncio.create_task(self._listener.accept(each)) for each in sockets or ()]

    def _protocol(self) -> asyncio.Protocol:
        """One HTTP connection, as uvicorn makes it."""
        make: Callable[..., asyncio.Protocol] = self.config.http_protocol_class
        return make(config=self.config, server_state=self.server_state, app_state=self.lifespan.state)

    def adopt(self, settings: Settings) -> None:
        """Use the limits and webhooks of other settings, from the next connection and the next event on.

        Raises:
            InputError: they cannot be used; nothing has changed.
        """
        settings.check()
        check_places(settings)
        before = self._registry.settings
        self._registry.adopt(settings)
        limits = self._handshakes.limits = self._registry.settings.limits
        _allow_descriptors(self._registry.settings)
        for protocol in (self.config.http_protocol_class, self.config.ws_protocol_class):
            protocol.limits = limits  # type: ignore[union-attr]
        self.config.ws_max_size, self.config.limit_concurrency = limits.message_bytes, limits.connections
        fields = Settings.model_fields.keys() - {"limits", "webhooks"}
        if others := sorted(name for name in fields if getattr(settings, name) != getattr(before, name)):
            _LOG.warning("changes of %s hold from the next start", ", ".join(others))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for task in self._accepting:
            task.cancel()
        await self._registry.drain()
        cutting = asyncio.create_task(self._cut_closed())
        await super().shutdown(sockets)
        cutting.cancel()

    async def _cut_closed(self) -> None:
        """Cut connections that are closed already, but wait for their peer: to take the last bytes, or to say goodbye.

        A browser reads nothing from a connection that it keeps for later, and a phone may sleep.
        """
        while True:
            await asyncio.sleep(_GOODBYE_SECONDS)
            for connection in list(self.server_state.connections):
                if connection.transport is not None and connection.transport.is_closing():
                    connection.transport.abort()
            if self._listener is not None:
                self._listener.cut_closed()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._registry.draining = True
        super().handle_exit(sig, frame)


def serve(settings: Settings, streams: Sequence[StreamSpec], read_settings: Callable[[], Settings]) -> None:
    """Serve until SIGTERM or SIGINT; SIGHUP reads tokens, certificates, limits and webhooks again.

    Args:
        settings: of the server.
        streams: to begin with.
        read_settings: reads the settings again.

    Raises:
        InputError: an address in use, or settings, tokens or state that cannot be used.
    """
    settings.check()
    os.environ[LOG_FORMAT_VARIABLE] = settings.log_format
    log_in_background()
    bound_arenas()
    _allow_descriptors(settings)
    listener = bind(settings.host, settings.port)
    try:
        app = create_app(settings, tuple(streams))
        registry: Registry = app.state.registry
        certificates = certificates_of(settings)
        config = server_config(app, settings)
        if settings.metrics_port is not None:
            _start_metrics(settings, registry)
        server = Server(config, registry, certificates)
        logging.getLogger("uvicorn.error").addFilter(_is_no_cancellation)
        threading.Thread(target=_warm, name="warm", daemon=True).start()
        parts = {"tokens": registry.gate.reload, "limits and webhooks": lambda: server.adopt(read_settings())}
        with _reload_on_hangup(parts if certificates is None else parts | {"certificates": certificates.reload}):
            place = found_at(listener, is_tls=settings.certificate is not None)
            others = " and all other addresses of this machine" if is_everywhere(listener) else ""
            _LOG.info("listening at %s%s", place, others)
            server.run(sockets=[listener])
    finally:
        listener.close()


def certificates_of(settings: Settings) -> Certificates | None:
    """The certificates of the settings, if they name some; InputError where these cannot be used."""
    if settings.certificate is None or settings.certificate_key is None:
        return None
    return Certificates(settings.certificate, settings.certificate_key)


def server_config(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """uvicorn's configuration for an application of `create_app`."""
    limits, turned_away = settings.limits, app.state.registry.turned_away
    return uvicorn.Config(
        app,
        http=http_class(limits, turned_away),
        ws=websocket_class(limits, turned_away),
        ws_per_message_deflate=False,
        ws_max_size=limits.message_bytes,
        ws_ping_interval=20,
        ws_ping_timeout=60,
        limit_concurrency=limits.connections,
        timeout_graceful_shutdown=2,
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        lifespan="on",
        access_log=False,
        log_config=None,
        server_header=False,
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=list(settings.proxies),
    )


def _warm() -> None:
    """Have the codec's kernels ready before the first packet comes."""
    leave_out_linear_algebra()
    warm_codec()
    page_out_compiler()


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """False for the traces of requests that were cancelled at shutdown, of which uvicorn already logs a line."""
    return record.exc_info is None or not isinstance(record.exc_info[1], asyncio.CancelledError)


def _allow_descriptors(settings: Settings) -> None:
    """Let the process open as many files and sockets as the server may need at once; the usual 1024 are used up before
    the server's own limits."""
    if sys.platform == "win32":
        return
    import resource

    count = (3 if settings.certificate else 2) * settings.limits.connections + _OTHER_DESCRIPTORS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = count if hard == resource.RLIM_INFINITY else min(count, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    if most < count:
        _LOG.warning("only %d files can be open, but limits.connections needs %d; raise the limit on open files", most,
                     count)  # fmt: skip


def bind(host: str, port: int) -> socket.socket:
    """A socket that listens there; InputError where it cannot."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise InputError(f"--host {host}", f"is not an address of this machine ({error.strerror})") from error
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        fault = f"cannot be listened on at {host} ({error.strerror}); stop what uses it, or choose another --port"
        raise InputError(f"port {port}", fault) from error
    return listener


def _start_metrics(settings: Settings, registry: Registry) -> None:
    """Serve the Prometheus metrics on a port of their own, from threads; a silent client is closed after a while."""
    assert settings.metrics_port is not None

    class Handler(WSGIRequestHandler):
        timeout = settings.limits.request_seconds

        def log_message(self, *_: object) -> None:
            """Say nothing: scrapes come every few seconds."""

    class Listener(ThreadingWSGIServer):
        address_family = socket.AF_INET6 if ":" in settings.metrics_host else socket.AF_INET

    address, app = (settings.metrics_host, settings.metrics_port), make_wsgi_app(collector_registry(registry))
    try:
        listener = make_server(*address, app, Listener, Handler)
    except OSError as error:
        raise InputError(f"metrics port {address[1]}", f"cannot be listened on ({error.strerror})") from error
    threading.Thread(target=listener.serve_forever, name="metrics", daemon=True).start()


@contextlib.contextmanager
def _reload_on_hangup(parts: Mapping[str, Callable[[], None]]) -> Iterator[None]:
    """Have SIGHUP call what reads each part again; one that cannot be read stays as it is."""

    def reload() -> None:
        for name, read in parts.items():
            try:
                read()
                _LOG.info("%s were read again", name)
            except StreamlodError as error:
                _LOG.error("%s were not read again, the earlier ones stay: %s", name, error)

    def on_hangup(_: int, __: FrameType | None) -> None:
        try:
            asyncio.get_running_loop().call_soon_threadsafe(reload)  # between two events, not in the middle of one
        except RuntimeError:  # the loop does not run yet
            reload()

    if sys.platform == "win32":
        yield
        return
    earlier = signal.signal(signal.SIGHUP, on_hangup)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, earlier)
