"""Commands that train a recording into a file, and measure what that gives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from streamlod.client.evaluation.options import STUDY_OPTIONS, TRADEOFF_OPTIONS, StudyOptions, TradeoffOptions
from streamlod.codec.snapshots import check_slod_output
from streamlod.core.files import check_output
from streamlod.server.cli.app import app
from streamlod.server.cli.given import require
from streamlod.server.cli.options import TRAINING, Data, Layout, SlodFile, names_in, takes
from streamlod.server.pipeline.job import TrainJob


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
    from streamlod.server.cli.commands import check_cameras
    from streamlod.server.cli.commands import train as run

    require(data)
    job = TrainJob(data=data, **options)
    check_slod_output(out)
    for path in (json, trace):
        if path is not None:
            check_output(path)
    check_cameras(job)
    typer.echo(run(job, out, json, trace, sound))


@app.command()
def evaluate(
    scene: SlodFile,
    data: Data,
    test: Annotated[
        str, typer.Option(metavar="cam00[,...]", help="Held-out cameras; without any, those that trained are measured.")
    ] = "",
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the report here, and a plot over frames beside it.")
    ] = None,
    save_images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write truth, rendering and difference side by side.")
    ] = None,
    layout: Layout = None,
    downscale: Annotated[
        float | None,
        typer.Option(
            min=1,
            max=64,
            help="How many times smaller than filmed the pictures are; by default as small as in training.",
        ),
    ] = None,
) -> None:
    """Decode a file, render its cameras or held-out ones, and measure quality, size and speed."""
    require(data)
    from streamlod.client.commands import evaluate as measure

    typer.echo(measure(scene, data, names_in(test), json, save_images, layout, downscale))


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
    require(data)
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
    require(data)
    from streamlod.client.evaluation.tradeoff import run_tradeoff

    typer.echo(run_tradeoff(data, out, TradeoffOptions(**options)))
