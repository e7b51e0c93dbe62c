"""Types and words of the command line's options."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from core.errors import InputError


class Device(StrEnum):
    """Where to compute."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


class Layout(StrEnum):
    """Of recordings: `core.data.LAYOUTS`, which is not loaded for a help text."""

    n3dv = "n3dv"
    meetroom = "meetroom"
    colmap = "colmap"
    transforms = "transforms"
    caliscope = "caliscope"


class SnapshotFormat(StrEnum):
    """Of exported snapshots."""

    ply = "ply"
    spz = "spz"


SlodFile = Annotated[Path, typer.Argument(metavar="FILE.slod", help="A recorded bitstream.")]
Data = Annotated[Path, typer.Argument(metavar="DATA", help="Folder of a recording; its layout is detected.")]
LayoutOption = Annotated[Layout | None, typer.Option(help="Layout of DATA, where detection is wrong.")]
Test = Annotated[str, typer.Option(metavar="cam00[,...]", help="Held-out cameras, never trained on.")]
DeviceOption = Annotated[Device, typer.Option(help="auto takes a CUDA device where there is one.")]
Views = Annotated[int | None, typer.Option(min=1, help="So many training cameras, evenly spread over the rest.")]
Preset = Annotated[str, typer.Option(help="live, balanced, quality or paper.")]
Seed = Annotated[int, typer.Option(min=0, help="Of everything random.")]
Frames = Annotated[int | None, typer.Option(min=1, help="At most so many frames.")]
SplitFile = Annotated[
    Path | None, typer.Option(help='JSON file {"train": [...], "test": [...]} that names cameras instead of views.')
]
FrameBudget = Annotated[
    float | None, typer.Option(min=1, metavar="MS", help="Train each later frame for so long; quality gives way.")
]
TargetRate = Annotated[float | None, typer.Option(min=1, metavar="KBPS", help="Keep predicted packets to this rate.")]
Interval = Annotated[
    int, typer.Option("--keyframe-interval", min=1, metavar="FRAMES", help="Most frames between keyframes.")
]
Downscale = Annotated[float, typer.Option(min=1, help="Make pictures so many times smaller.")]


def names_in(text: str) -> tuple[str, ...]:
    """Words between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def numbers_in(option: str, text: str) -> tuple[int, ...]:
    """Positive whole numbers of ``3,4,5``."""
    words = names_in(text)
    if not words or not all(word.isascii() and word.isdecimal() and 0 < len(word) < 6 and int(word) for word in words):
        raise InputError(option, f"{text!r} is not a list of positive numbers, for example 3,4,5")
    return tuple(dict.fromkeys(int(word) for word in words))
