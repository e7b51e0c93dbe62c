"""Jobs: what is trained, and how. Plain values, which are sent to the worker process and kept in `stream.json`.

The fields of `TrainJob` are the one declaration of their names, bounds, defaults and help (`core.options`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from streamlod.core.errors import InputError
from streamlod.core.options import (
    MAX_CAMERAS,
    device_option,
    downscale_option,
    option,
    options_of,
    preset_option,
    test_option,
)

SOURCES = ("data", "live", "synthetic")
MAX_PATH = 4096
MAX_TEXT = 250  # characters of a title or licence, which has 1024 bytes in a file
ONE_LINE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]+$"
POINT_METHODS = ("auto", "colmap", "sweep", "colmap+sweep", "learned", "vggt", "depth-anything", "random")


@dataclass(frozen=True, slots=True)
class TrainJob:
    """Exactly one of `data`, `live` and `synthetic` says where frames come from; the help of each field says the rest.

    Where `train` is empty, `views` of the cameras that `test` does not name are chosen by the linspace rule
    (`core.data.linspace_split`). Text stands for a path, a list for a tuple.

    Raises:
        InputError: no single source, a value of another type or out of bounds, a camera that trains and is held out.
    """

    data: Path | None = option(None, "Train this folder of a recording.", metavar="DATA", max_length=MAX_PATH)
    live: Path | dict[str, Any] | None = option(
        None, "Train what the cameras of this rig film: its file, or by REST the rig itself.", metavar="RIG.json"
    )
    synthetic: dict[str, int | float | str | bool] | None = option(
        None, "Train a synthetic clip made on the fly.", metavar="cameras=5,frames=30"
    )
    layout: str | None = option(
        None,
        "Layout of the recording, where detection is wrong.",
        choices=("n3dv", "meetroom", "colmap", "transforms", "caliscope"),
    )
    train: tuple[str, ...] = option((), "Training cameras by name.", metavar="cam01,cam02", max_length=MAX_CAMERAS)
    test: tuple[str, ...] = test_option()
    views: int | None = option(
        None, "So many training cameras, evenly spread over the rest.", minimum=1, maximum=MAX_CAMERAS
    )
    frames: int | None = option(None, "At most so many frames.", minimum=1, maximum=10_000_000)
    downscale: float = downscale_option()
    preset: str = preset_option()
    set: dict[str, int | float | str | bool] | None = option(
        None,
        "Settings of the method in place of the preset's, by part and name; docs/preset-paper.md has all.",
        metavar="keyframe.steps=500,new_anchors.share=0.002",
        max_length=MAX_PATH,
    )
    device: str = device_option()
    seed: int = option(0, "Of everything random.", minimum=0, maximum=2**31 - 1)
    points: str = option(
        "auto",
        f"First points: {', '.join(POINT_METHODS)}, or a .ply or .npz file.",
        metavar="METHOD|FILE",
        max_length=MAX_PATH,
    )
    keyframe_interval: int = option(
        100, "Most frames between keyframes.", minimum=1, maximum=1_000_000, metavar="FRAMES"
    )
    frame_budget_ms: float | None = option(
        None, "Train each later frame for so many milliseconds; quality gives way.",
        minimum=1, maximum=1e6, metavar="MS",
    )  # fmt: skip
    target_kbps: float | None = option(
        None, "Keep predicted packets to this rate, in kilobits a second.", minimum=1, maximum=1e7, metavar="KBPS"
    )
    title: str | None = option(
        None,
        "What people call the scene; the file tells it.",
        max_length=MAX_TEXT,
        pattern=ONE_LINE,
        matching="one line of text",
    )
    licence: str | None = option(
        None, "Under which licence it may be used, as an SPDX expression or an address; the file tells it.",
        metavar="CC-BY-4.0", max_length=MAX_TEXT, pattern=ONE_LINE, matching="one line of text",
    )  # fmt: skip

    def __post_init__(self) -> None:
        for name in ("data", "live"):
            if isinstance(value := getattr(self, name), str):
                object.__setattr__(self, name, Path(value))
        for name in ("train", "test"):
            if isinstance(value := getattr(self, name), list):
                object.__setattr__(self, name, tuple(value))
        if sum(getattr(self, name) is not None for name in SOURCES) != 1:
            raise InputError("what to train", "name one source: data, live or synthetic")
        for each in JOB_OPTIONS:
            each.check(getattr(self, each.name))
        both = sorted(set(self.train) & set(self.test))
        if both:
            raise InputError("train", f"{', '.join(both)} cannot both train and be held out by test")
        for name in ("title", "licence"):
            if any("\ud800" <= letter <= "\udfff" for letter in getattr(self, name) or ""):
                raise InputError(name, "is not UTF-8")

    def to_json(self) -> dict[str, Any]:
        """Plain values, of which the constructor makes the same job."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


JOB_OPTIONS = options_of(TrainJob)
JOB_FIELDS = frozenset(each.name for each in JOB_OPTIONS)
