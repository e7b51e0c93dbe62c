"""The command `streamlod`. Options are declared here; each function imports what it does, which is heavy."""

from __future__ import annotations

import logging
import os
import signal
import sys
import traceback
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from streamlod.client.evaluation.options import STUDY_OPTIONS, TRADEOFF_OPTIONS, StudyOptions, TradeoffOptions
from streamlod.codec.snapshots import CLIP_SUFFIXES, FORMATS, PACKET_SUFFIXES
from streamlod.core.background_log import LOG_FORMAT
from streamlod.core.errors import InputError
from streamlod.core.version import streamlod_version
from streamlod.server.cli.explain import INTERRUPTED, explain
from streamlod.server.cli.options import (
    DEFAULTS,
    TRAINING,
    CaFile,
    Config,
    Data,
    Device,
    Frames,
    Host,
    Insecure,
    Layout,
    MetricsPort,
    Port,
    Seed,
    SlodFile,
    Test,
    Tokens,
    TraceEndpoint,
    fields_in,
    names_in,
    takes,
)
from streamlod.server.pipeline.job import SOURCES, TrainJob
from streamlod.server.pipeline.spec import STREAM_OPTIONS, spec_from_json

if TYPE_CHECKING:
    from streamlod.server.settings import Settings

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
    fps: Annotated[float, typer.Option(min=0.1, max=1000, help="Pictures a second.")] = 30.0,
    record: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Record the cameras of a rig.json, a video each, to calibrate.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=1, max=7200, help="How long to record.")] = 60.0,
    config: Config = None,
    host: Host = None,
    port: Port = None,
    tokens: Tokens = None,
    insecure: Insecure = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier rig.json or recording.")] = False,
) -> None:
    """Find cameras and write rig.json, with a picture of what each sees; or watch and record those of a rig.json.

    Phones are shown a QR code of the page /capture, on which they film. Host, port and rights are those of serve.
    """
    from streamlod.server.cli.commands import picture_size
    from streamlod.server.cli.rig import find, watch

    given = sources or []
    if len(given) == 1 and given[0].endswith(".json"):
        settings = _settings(config, host=host, port=port, tokens=tokens, insecure=insecure or None)
        watch(Path(given[0]), record, seconds, settings, typer.echo, overwrite=overwrite)
    elif record is not None:
        raise InputError("--record", "records the cameras of a rig.json; write that first, and give it")
    else:
        wanted = None if size is None else picture_size(size)
        find(given, out, phones, wanted, fps, "walk", typer.echo, overwrite=overwrite)


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
        typer.Option(metavar="COLUMNSxROWS|FILE.toml", help="The board; by default DATA/charuco.toml, else 7x5."),
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
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier calibration.")] = False,
) -> None:
    """Calibrate cameras with a ChArUco board that somebody walks through the scene: lenses, poses, time offsets.

    Writes what train and serve read, rig.json, a report and a picture.
    """
    from streamlod.server.cli.calibrate import calibrate as run
    from streamlod.server.cli.calibrate import print_board as write_board

    if print_board is not None:
        typer.echo(write_board(print_board, board, square_mm))
    elif data is None:
        raise InputError("calibrate", "needs DATA, the folder of the videos, or --print-board FILE.pdf")
    else:
        typer.echo(run(data, out, board, square_mm, lenses, overwrite))


@app.command()
def check(
    source: Annotated[Path, typer.Argument(metavar="DATA|rig.json", help="A recording, or a live rig.")],
    layout: Layout = None,
) -> None:
    """Check a rig before it films: focus, light, clocks, poses, coverage; exit code 1 where something is at fault."""
    _require_folder(source)
    from streamlod.server.cli.check import check as examine

    text, at_fault = examine(source, layout)
    typer.echo(text)
    if at_fault:
        raise typer.Exit(1)


@app.command()
@takes(TRAINING)
def train(
    data: Data,
    out: Annotated[Path, typer.Option(metavar="FILE.slod", help="Bitstream to write.")],
    json: Annotated[Path | None, typer.Option(metavar="FILE", help="Also write the figures here.")] = None,
    trace: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the stages as a Chrome trace.")] = None,
    sound: Annotated[
        str, typer.Option(metavar="auto|none|CAMERA|FILE", help="Whose; auto: of the first camera that has some.")
    ] = "auto",
    **options: Any,
) -> None:
    """Train a clip offline into a bitstream file; beside it go figures of the training, FILE.slod.json, and sound.

    A fault after the first frame, such as a damaged picture, ends the file there, whole, with exit code 2.
    """
    from streamlod.server.cli.commands import check_cameras, check_outputs
    from streamlod.server.cli.commands import train as run

    _require_folder(data)
    job = TrainJob(data=data, **options)
    check_outputs(out, json, trace)
    check_cameras(job)
    typer.echo(run(job, out, json, trace, sound))


@app.command()
def evaluate(
    scene: SlodFile,
    data: Data,
    test: Test,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the report here, and a plot over frames beside it.")
    ] = None,
    save_images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write truth, rendering and difference side by side.")
    ] = None,
    layout: Layout = None,
    downscale: Annotated[
        float | None,
        typer.Option(help="How many times smaller than filmed the pictures are; by default as small as in training."),
    ] = None,
) -> None:
    """Decode a file, render the held-out cameras, and measure quality, size and speed."""
    _require_folder(data)
    from streamlod.client.commands import evaluate as measure

    typer.echo(measure(scene, data, names_in(test), json, save_images, layout, downscale))


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
        _settings, config, host=host, port=port, state=state_dir, tokens=tokens, metrics_port=metrics_port,
        trace_endpoint=trace_endpoint, log_format=log_format, insecure=insecure or None,
    )  # fmt: skip
    settings = read_settings()
    streams = tuple(stream.spec for stream in settings.streams)
    if any(options[name] is not None for name in (*SOURCES, "play")):
        if options["play"] is not None:
            options["play"] = playable(options["play"])
        for name in ("data", "live"):
            if options[name] is not None:
                _require_folder(options[name])
        stream = replace(spec_from_json(options), recorded=options["play"] is None)
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
        _settings, config, host=host, port=port, tokens=tokens, metrics_port=metrics_port,
        trace_endpoint=trace_endpoint, insecure=insecure or None,
        edge={"origin": origin, "streams": names_in(streams)},
    )  # fmt: skip
    run(read_settings(), (), read_settings)


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
    url: Annotated[str, typer.Argument(metavar="ws://HOST:PORT/v1/streams/ID/live", help="A live stream.")],
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
) -> None:
    """Watch a live stream from Python and record what a viewpoint sees. A token comes from STREAMLOD_TOKEN."""
    from streamlod.client.commands import view as watch

    typer.echo(watch(url, out, camera, orbit, pose, frames, levels, fps, path))


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


@app.command()
def info(scene: SlodFile) -> None:
    """Say what is inside a file, with sizes by level and kind of chunk."""
    from streamlod.client.commands import info as describe

    typer.echo(describe(scene))


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
) -> None:
    """Make a file that can be served and viewed of Gaussians that other programs wrote, or of packets in MP4 or HLS."""
    from streamlod.client.commands import import_scene as convert

    typer.echo(convert(source, out, fps, gaussians))


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def bench(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(help="Which; without a name they are listed.")] = None,
) -> None:
    """Run a benchmark of the source checkout; further arguments are its own."""
    from streamlod.server.cli.commands import bench as run

    if text := run(name, context.args):
        typer.echo(text)


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


@app.command()
@takes(STUDY_OPTIONS)
def study(
    data: Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder; what it holds is not redone.")] = Path(
        "study-output"
    ),
    **options: Any,
) -> None:
    """Measure what each part of the method is worth, by leaving it out, on cameras that training never saw."""
    _require_folder(data)
    from streamlod.client.evaluation.study import run_study

    typer.echo(run_study(data, out, StudyOptions(**options)))


@app.command()
@takes(TRADEOFF_OPTIONS)
def tradeoff(
    data: Data,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder; what it holds stays.")] = Path("tradeoff-output"),
    **options: Any,
) -> None:
    """Sweep time, size and quality against each other; finds what nothing else beats."""
    _require_folder(data)
    from streamlod.client.evaluation.tradeoff import run_tradeoff

    typer.echo(run_tradeoff(data, out, TradeoffOptions(**options)))


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
def warm() -> None:
    """Compile the kernels now, so that the first frame does not wait for it."""
    from streamlod.server.cli.commands import warm as compile_all

    typer.echo(compile_all())


def main() -> NoReturn:
    """Entry point: one sentence and exit code 2 for everything refused."""
    arguments = [argument for argument in sys.argv[1:] if argument not in {"--debug", "--verbose"}]
    debug, verbose = "--debug" in sys.argv, "--verbose" in sys.argv
    _configure_logging(verbose or debug)
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = app(args=arguments, standalone_mode=False)
    except KeyboardInterrupt:
        sys.stderr.write("\ninterrupted\n")
        code = INTERRUPTED
    except Exception as error:
        if debug:
            traceback.print_exc()
        code = explain(error)
    raise SystemExit(code or 0)


def _configure_logging(verbose: bool) -> None:
    level = logging.DEBUG if verbose else logging.INFO
    logging.basicConfig(stream=sys.stderr, format=LOG_FORMAT, level=logging.WARNING)
    logging.getLogger("streamlod").setLevel(level)


def _terminate(_: int, __: Any) -> NoReturn:
    raise KeyboardInterrupt


def _settings(config: Path | None, **given: Any) -> Settings:
    """The settings of a file, if there is one, with the options that were given in place of its own."""
    from streamlod.server.settings import Settings, load_settings

    loaded = {} if config is None else load_settings(config).model_dump()
    chosen = {name: value for name, value in given.items() if value is not None}
    if isinstance(chosen.get("edge"), dict):  # the rest of the file's table stays
        chosen["edge"] = (loaded.get("edge") or {}) | chosen["edge"]
    return Settings(**loaded | chosen)


def _require_folder(path: Path) -> None:
    """Say so at once, before anything heavy is loaded."""
    if not path.exists():
        raise InputError(path, "does not exist")
