"""Commands that speak to a server elsewhere: send cameras, watch, control."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from streamlod.server.cli.app import app
from streamlod.server.cli.options import CaFile, Frames, fields_in


@app.command()
def push(
    url: Annotated[str, typer.Argument(metavar="ws://HOST:PORT/v1/streams/ID/ingest", help="Where to.")],
    sources: Annotated[
        list[str], typer.Argument(metavar="NAME=SOURCE|DIR...", help="Cameras: a video, pictures, v4l2:///dev/video0.")
    ],
    fps: Annotated[float, typer.Option(min=0.1, max=1000, help="Of webcams and folders of pictures.")] = 30.0,
    size: Annotated[str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Asked of webcams.")] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin files again at their end.")] = False,
    ca: CaFile = None,
) -> None:
    """Send this machine's cameras to a live stream with push: sources. A token comes from STREAMLOD_TOKEN."""
    from streamlod.server.cli.commands import push as send

    typer.echo(send(url, sources, fps, size, loop, ca))


@app.command()
def view(
    url: Annotated[
        str,
        typer.Argument(metavar="ws://HOST:PORT/v1/streams/ID/live", help="A live stream, or the address of its page."),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR|FILE.mp4", help="Folder of PNGs, or a video.")],
    camera: Annotated[str | None, typer.Option(metavar="cam00", help="Stand at a camera of the rig.")] = None,
    orbit: Annotated[bool, typer.Option("--orbit", help="Circle inside the rig.")] = False,
    pose: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Stand at poses of a file.")] = None,
    path: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Go along a camera path that the page saved.")
    ] = None,
    frames: Frames = None,
    levels: Annotated[int | None, typer.Option(min=1, help="Ask for so many levels only.")] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            "--fps", min=0.1, max=1000, metavar="60", help="Of the film; more than the stream has are interpolated."
        ),
    ] = None,
    from_start: Annotated[
        bool, typer.Option("--from-start", help="Begin with the oldest that the server has kept, not live.")
    ] = False,
) -> None:
    """Watch a live stream from Python and record what a viewpoint sees, until Ctrl-C.

    A token comes from STREAMLOD_TOKEN.
    """
    from streamlod.client.commands import view as watch

    typer.echo(watch(url, out, camera, orbit, pose, frames, levels, fps, path, from_start))


@app.command()
def remote(
    address: Annotated[str, typer.Argument(metavar="http://HOST:PORT", help="A server.")],
    action: Annotated[
        str,
        typer.Argument(
            metavar="ACTION",
            help="list, show, create, change, start, stop, delete, viewers, disconnect, recordings, download, events, "
            "server.",
        ),
    ],
    name: Annotated[str | None, typer.Argument(metavar="ID", help="The stream.")] = None,
    set_: Annotated[
        str, typer.Option("--set", metavar="NAME=VALUE[,...]", help="Fields, such as play=/data/a.slod,start=true.")
    ] = "",
    out: Annotated[Path | None, typer.Option(metavar="FILE.slod", help="File of a download.")] = None,
    ca: CaFile = None,
) -> None:
    """Control a server by REST; results are JSON, one a line. A token comes from STREAMLOD_TOKEN."""
    from streamlod.client.remote import remote as control

    for line in control(address, action, name, fields_in(set_), out, ca):
        typer.echo(line)
