"""Commands about this machine: a demonstration, benchmarks, checks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from streamlod.server.cli.app import app
from streamlod.server.cli.options import DEFAULTS, Device, Frames


@app.command()
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the results.")] = Path("demo-output"),
    cameras: Annotated[int | None, typer.Option(min=2, help="Cameras of the clip.")] = None,
    frames: Frames = None,
    size: Annotated[str | None, typer.Option(help="Picture size, WIDTHxHEIGHT.")] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Port of the server.  [default: 8000]")] = None,
) -> None:
    """Make a clip, train it live, serve it, watch it, measure it; serves on until Ctrl-C unless DEMO_EXIT=1."""
    from streamlod.server.cli.demo import DemoSettings, run_demo

    given: dict[str, Any] = {"out": out, "cameras": cameras, "frames": frames, "size": size, "port": port}
    stay = os.environ.get("DEMO_EXIT", "") not in {"1", "true", "yes"}
    run_demo(DemoSettings(**{name: value for name, value in given.items() if value is not None}, stay=stay))


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def bench(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(help="Which; without a name they are listed.")] = None,
) -> None:
    """Run a benchmark of the source checkout; further arguments are its own.

    Most say which by `bench NAME -- --help`.
    """
    from streamlod.server.cli.commands import bench as run

    if text := run(name, context.args):
        typer.echo(text)


@app.command()
def doctor(
    device: Device = DEFAULTS["device"],
    host: Annotated[str, typer.Option(help="Address that the service would listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port that it would listen on.")] = 8000,
    state_dir: Annotated[Path | None, typer.Option(metavar="DIR", help="Where it would record.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Leave out gradients and speed; a few seconds.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Check what this machine can do; exit code 1 where something that was asked for does not work."""
    from streamlod.server.doctor.report import as_json, as_table, examine, worst

    findings = examine(device, host, port, state_dir, quick)
    typer.echo(as_json(findings) if json else as_table(findings))
    if worst(findings) == "fault":
        raise typer.Exit(1)


@app.command()
def version() -> None:
    """Say which version of streamlod this is, and which bitstream, viewer protocol and Python it has."""
    from streamlod.server.cli.commands import version as describe

    typer.echo(describe())


@app.command()
def warm() -> None:
    """Compile the kernels now, so that the first frame does not wait for it."""
    from streamlod.server.cli.commands import warm as compile_all

    typer.echo(compile_all())
