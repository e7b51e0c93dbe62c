"""Commands before anything is trained: a clip to try, cameras, their calibration, its check."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from streamlod.core.errors import InputError
from streamlod.server.cli.app import app
from streamlod.server.cli.given import chosen_settings, require
from streamlod.server.cli.options import DEFAULTS, Config, Host, Insecure, Layout, Port, Seed, Tokens

if TYPE_CHECKING:
    from streamlod.server.ingest.finding.soap import Login

_MAX_LOGIN = 256  # characters


@app.command()
def synth(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write; must not exist, or be empty.")],
    cameras: Annotated[int, typer.Option(min=1, help="Number of cameras.")] = 13,
    frames: Annotated[int, typer.Option(min=1, help="Number of frames.")] = 60,
    size: Annotated[str, typer.Option(help="Picture size, WIDTHxHEIGHT.")] = "480x270",
    seed: Seed = DEFAULTS["seed"],
    kind: Annotated[str, typer.Option(help="The place: room, bright, night, theatre, outdoor or hard.")] = "room",
    speed: Annotated[float, typer.Option(min=0, help="Pixels a frame of the fastest; 0: the place's own pace.")] = 0.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier synthetic clip at OUT.")] = False,
) -> None:
    """Write a synthetic clip in the N3DV layout (camNN.mp4 and poses_bounds.npy), with its ground truth beside it."""
    from streamlod.server.cli.commands import synth as write

    typer.echo(write(out, cameras, frames, size, seed, kind, speed, overwrite))


@app.command()
def rig(
    sources: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME=]SOURCE...|rig.json", help="Addresses of cameras; without, they are looked for."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="rig.json", help="File to write.")] = Path("rig.json"),
    phones: Annotated[int, typer.Option(min=0, max=64, help="So many phones more, which film in their browsers.")] = 0,
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Asked of webcams and phones.  [default: 1280x720]")
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="Pictures a second; by default those of the slowest camera.")
    ] = None,
    sound: Annotated[
        str | None, typer.Option(metavar="NAME|SOURCE", help="Whose sound is heard: a camera, a microphone or a file.")
    ] = None,
    login: Annotated[
        str | None, typer.Option(metavar="USER:PASSWORD", help="Of network cameras that are looked for (ONVIF).")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Record the cameras of a rig.json, a video each, and its sound.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=1, max=7200, help="How long to record (60), or to show what cameras see (until Ctrl-C)."),
    ] = None,
    config: Config = None,
    host: Host = None,
    port: Port = None,
    tokens: Tokens = None,
    insecure: Insecure = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier rig.json or recording.")] = False,
) -> None:
    """Find cameras and write rig.json, with a picture of what each sees; or watch and record those of a rig.json.

    While it records, it tells what the cameras still need to see of a calibration board that somebody walks about with.
    Its page /cameras shows all pictures at once. Phones are shown a QR code of the page /capture, on which they film.
    Host, port and rights are those of serve.
    """
    from streamlod.server.cli.commands import picture_size
    from streamlod.server.cli.rig import find, watch

    given = sources or []
    if login is not None and given:
        raise InputError("--login", "is for cameras that are looked for; write rtsp://USER:PASSWORD@... as a source")
    if len(given) == 1 and given[0].endswith(".json"):
        if sound is not None:
            raise InputError("--sound", f"is for a new rig; write it into the field sound of {given[0]}")
        for name, value in {"phones": phones or None, "size": size, "fps": fps}.items():
            if value is not None:
                raise InputError(f"--{name}", f"is for a new rig; change {given[0]}, or write a new one")
        settings = chosen_settings(config, host=host, port=port, tokens=tokens, insecure=insecure or None)
        watch(Path(given[0]), record, seconds, settings, typer.echo, overwrite=overwrite)
    elif record is not None:
        raise InputError("--record", "records the cameras of a rig.json; write that first, and give it")
    elif seconds is not None:
        raise InputError("--seconds", "is for a rig.json that is shown or recorded; write that first, and give it")
    else:
        wanted = None if size is None else picture_size(size)
        find(given, out, phones, wanted, fps, typer.echo, sound=sound, login=_login(login), overwrite=overwrite)


def _login(text: str | None) -> Login | None:
    """A user and a password, which may hold colons."""
    from streamlod.server.ingest.finding.soap import Login

    if text is None:
        return None
    user, colon, password = text.partition(":")
    if not (user and colon and text.isprintable() and len(text) <= _MAX_LOGIN):
        raise InputError("--login", "write USER:PASSWORD")
    return Login(user, password)


@app.command()
def calibrate(
    data: Annotated[
        Path | None, typer.Argument(metavar="DATA", help="Folder of the cameras' videos of a board walk, one each.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; the videos' own by default.")
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMNSxROWS|FILE.toml", help="The board; by default charuco.toml in DATA or beside it, else 7x5."
        ),
    ] = None,
    square_mm: Annotated[
        float | None, typer.Option(min=1, max=5000, help="Side of a square as it was measured.  [default: 55]")
    ] = None,
    lenses: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the lenses of this calibrated recording.")
    ] = None,
    print_board: Annotated[
        Path | None, typer.Option(metavar="A3.pdf|.png", help="Write the board for printing, and nothing else.")
    ] = None,
    features: Annotated[
        bool, typer.Option("--features", help="Without a board, from what neighbouring cameras see alike.")
    ] = False,
    apart: Annotated[
        str | None,
        typer.Option(
            metavar="CAMERA:CAMERA=METRES", help="With --features: how far apart two cameras are, lens to lens."
        ),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier calibration.")] = False,
) -> None:
    """Calibrate cameras with a ChArUco board that somebody walks through the scene: lenses, poses, time offsets.

    Writes what train and serve read, rig.json, a report and a picture. With --features no board is needed, but cameras
    that stand near each other (20 degrees), and clocks that agree.
    """
    from streamlod.server.cli.calibrate import calibrate as run
    from streamlod.server.cli.calibrate import print_board as write_board
    from streamlod.server.cli.calibrate_features import calibrate_features

    if print_board is not None:
        typer.echo(write_board(print_board, board, square_mm))
    elif data is None:
        raise InputError("calibrate", "needs DATA, the folder of the videos, or --print-board FILE.pdf")
    elif features and (board is not None or square_mm is not None):
        raise InputError("--features", "is for footage without a board; leave --board and --square-mm out")
    elif apart is not None and not features:
        raise InputError("--apart", "is for --features; a board's squares tell all lengths")
    elif features:
        typer.echo(calibrate_features(data, out, apart, lenses, overwrite))
    else:
        typer.echo(run(data, out, board, square_mm, lenses, overwrite))


@app.command()
def check(
    source: Annotated[Path, typer.Argument(metavar="DATA|rig.json", help="A recording, or a live rig.")],
    layout: Layout = None,
    config: Config = None,
    host: Host = None,
    port: Port = None,
    tokens: Tokens = None,
    insecure: Insecure = False,
) -> None:
    """Check a rig before it films: focus, light, clocks, poses, coverage; exit code 1 where something is at fault.

    Phones of a live rig are shown a QR code, as by the command rig; host, port and rights are those of serve.
    """
    require(source)
    from streamlod.server.cli.check import check as examine

    settings = chosen_settings(config, host=host, port=port, tokens=tokens, insecure=insecure or None)
    text, at_fault = examine(source, layout, settings, typer.echo)
    typer.echo(text)
    if at_fault:
        raise typer.Exit(1)
