"""Commands that read and write files of scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from streamlod.codec.snapshots import AXES, CLIP_SUFFIXES, FORMATS, PACKET_SUFFIXES
from streamlod.server.cli.app import app
from streamlod.server.cli.options import SlodFile, one_of


@app.command()
def info(scene: SlodFile) -> None:
    """Say what is inside a file, with sizes by level and kind of chunk."""
    from streamlod.client.inspection import describe_file

    typer.echo(describe_file(scene))


@app.command()
def export(
    scene: SlodFile,
    frame: Annotated[int, typer.Option(min=0, help="Frame number.")] = 0,
    view: Annotated[
        str, typer.Option(metavar="cam00|average", help="Where view-dependent colour is frozen.")
    ] = "average",
    format: Annotated[
        str,
        typer.Option(
            metavar="|".join((*FORMATS, *CLIP_SUFFIXES, *PACKET_SUFFIXES)),
            help="File format; 4dgs, usd: all frames; mp4, hls: the packets themselves, with sound.",
        ),
    ] = "ply",
    out: Annotated[Path | None, typer.Option(help="File, or folder of a sequence.")] = None,
    sequence: Annotated[bool, typer.Option("--sequence", help="One file for every frame from there on.")] = False,
) -> None:
    """Write plain 3D Gaussians that other viewers and editors read, or packets in MP4 that packagers carry."""
    from streamlod.client.commands import export as write

    typer.echo(write(scene, frame, view, format, out, sequence))


@app.command("import")
def import_scene(
    source: Annotated[
        str,
        typer.Argument(metavar="FILE|DIR|URL", help=".ply, .spz, .4dgs, .glb, .mp4, a folder of frames, a .m3u8."),
    ],
    out: Annotated[Path | None, typer.Option(metavar="FILE.slod", help="Beside the source by default.")] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=1000, help="Of a folder's frames.")] = 30.0,
    gaussians: Annotated[int, typer.Option(min=1, help="Keep so many at most, those that show most.")] = 262_144,
    up: Annotated[
        str | None,
        typer.Option(
            parser=one_of(AXES),
            metavar="|".join(AXES),
            help="Which axis of the file points up; -y by default for .ply, y for others.",
        ),
    ] = None,
) -> None:
    """Make a file that can be served and viewed of Gaussians that other programs wrote, or of packets in MP4 or HLS."""
    from streamlod.client.commands import import_scene as convert

    typer.echo(convert(source, out, fps, gaussians, up))
