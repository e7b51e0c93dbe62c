"""Commands that run the service: a server, and an edge before one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from streamlod.server.cli.app import app
from streamlod.server.cli.given import chosen_settings, require
from streamlod.server.cli.options import (
    Config,
    Host,
    Insecure,
    MetricsPort,
    Port,
    Tokens,
    TraceEndpoint,
    names_in,
    takes,
)
from streamlod.server.pipeline.job import SOURCES
from streamlod.server.pipeline.spec import STREAM_OPTIONS, spec_from_json


@app.command()
@takes(STREAM_OPTIONS)
def serve(
    host: Host = None,
    port: Port = None,
    state_dir: Annotated[Path | None, typer.Option(metavar="DIR", help="Record streams here.")] = None,
    config: Config = None,
    tokens: Tokens = None,
    metrics_port: MetricsPort = None,
    trace_endpoint: TraceEndpoint = None,
    log_format: Annotated[Literal["text", "json"] | None, typer.Option(help="Lines of the log.")] = None,
    insecure: Insecure = False,
    **options: Any,
) -> None:
    """Run the service: REST, live websocket and the viewer page. Without a source, streams come by REST."""
    from streamlod.server.cli.commands import check_cameras, playable
    from streamlod.server.cli.commands import serve as run

    read_settings = partial(
        chosen_settings, config, host=host, port=port, state=state_dir, tokens=tokens, metrics_port=metrics_port,
        trace_endpoint=trace_endpoint, log_format=log_format, insecure=insecure or None,
    )  # fmt: skip
    settings = read_settings()
    streams = tuple(stream.spec for stream in settings.streams)
    if any(options[name] is not None for name in (*SOURCES, "play")):
        for name in ("data", "live"):
            if options[name] is not None:
                require(options[name])
        stream = replace(spec_from_json(options), recorded=options["play"] is None)
        if stream.play is not None:
            stream = replace(stream, play=playable(stream.play))
        if stream.job is not None:
            check_cameras(stream.job)
        streams += (stream,)
    run(settings, streams, read_settings)


@app.command()
def edge(
    origin: Annotated[str, typer.Option(metavar="http://HOST:PORT", help="The server whose streams to serve.")],
    streams: Annotated[str, typer.Option(metavar="ID[,ID...]", help="Which of them; all by default.")] = "",
    host: Host = None,
    port: Port = None,
    config: Config = None,
    tokens: Tokens = None,
    metrics_port: MetricsPort = None,
    trace_endpoint: TraceEndpoint = None,
    insecure: Insecure = False,
) -> None:
    """Serve another server's streams to many viewers; each is pulled once. A token comes from STREAMLOD_TOKEN."""
    from streamlod.server.cli.commands import serve as run

    read_settings = partial(
        chosen_settings, config, host=host, port=port, tokens=tokens, metrics_port=metrics_port,
        trace_endpoint=trace_endpoint, insecure=insecure or None,
        edge={"origin": origin, "streams": names_in(streams)},
    )  # fmt: skip
    run(read_settings(), (), read_settings)
