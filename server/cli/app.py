"""The command `streamlod` before it has commands; `server.cli.declared` adds them."""

from __future__ import annotations

from typing import Annotated

import typer

from streamlod.core.version import streamlod_version

app = typer.Typer(
    name="streamlod",
    epilog="--debug (tracebacks) and --verbose (more log) may stand anywhere. Try `streamlod demo` first.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"streamlod {streamlod_version()}")
        raise typer.Exit


@app.callback()
def options_of_all(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    """Live free-viewpoint video: train a scene frame by frame from synchronised cameras, stream it, watch it."""
