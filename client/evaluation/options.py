"""Options of `streamlod study` and `streamlod tradeoff`, which this module declares without loading what measures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from streamlod.client.evaluation.jobs import Jobs
from streamlod.core.options import device_option, downscale_option, option, options_of, preset_option, test_option

_SPLIT = 'JSON file {"train": [...], "test": [...]} that names cameras instead of views.'


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """Settings of a study; the help of each field says what it does.

    `views` are numbers of training cameras, one split each by the linspace rule; `test` is the first camera of the rig
    where none is named; `ablate` names parts as `client.evaluation.rows` has them.
    """

    views: tuple[int, ...] = option((3,), "Numbers of training cameras to compare.", metavar="3[,4,...]")
    frames: int | None = option(10, "At most so many frames.", minimum=1)
    seeds: int = option(3, "Runs of each system.", minimum=1, maximum=100)
    ablate: tuple[str, ...] = option(
        ("all",),
        "Parts to leave out in turn: all, or some of lod,partition,quantisation,dropout,star,cue.",
        metavar="PART[,...]",
    )
    downscale: float = downscale_option()
    test: tuple[str, ...] = test_option()
    split: Path | None = option(None, _SPLIT, metavar="FILE")
    preset: str = preset_option()
    device: str = device_option()
    jobs: Jobs = option(
        "local",
        "Runs one after another, or side by side on a Ray cluster: times then differ.",
        choices=("local", "ray"),
    )


@dataclass(frozen=True, slots=True)
class TradeoffOptions:
    """Settings of a sweep; the help of each field says what it does.

    `views` is None for all cameras that are not held out; `downscale` is of the held-out pictures, and of the training
    pictures where that is not the setting that varies; figures are means over the `seeds`.
    """

    frames: int | None = option(8, "At most so many frames.", minimum=1)
    views: int | None = option(5, "So many training cameras.", minimum=1)
    downscale: float = downscale_option()
    test: tuple[str, ...] = test_option()
    split: Path | None = option(None, _SPLIT, metavar="FILE")
    device: str = device_option()
    seeds: int = option(1, "Runs of each point.", minimum=1, maximum=100)


STUDY_OPTIONS = options_of(StudyOptions)
TRADEOFF_OPTIONS = options_of(TradeoffOptions)
