"""What is trained, and how: small and plain, so that it travels to a worker process and lies in a catalogue as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from core.errors import InputError

SOURCES = ("data", "live", "synthetic")


@dataclass(frozen=True, slots=True)
class TrainJob:
    """Exactly one of `data`, `live` and `synthetic` says where frames come from.

    Attributes:
        data: folder of a data set.
        live: description of a live rig (docs/ingest.md): its file, or the same as a mapping.
        synthetic: fields of `core.synthetic.SyntheticSpec` for a clip made on the fly.
        layout: of the folder, or None to detect it.
        train, test: names of cameras; where `train` is empty, `views` of the rest are chosen by the linspace rule.
        frames: at most so many, or None for all.
        downscale: factor by which pictures are made smaller.
        preset, device, seed: of the trainer.
        points: where first points come from, see `core.initialise.first_points`.
        keyframe_interval: most frames between keyframes; sooner ones come when they save bytes (`codec.renewal`).
        frame_budget_ms: wall time for training each later frame, or None for as long as it takes.
        target_kbps: kilobits a second for predicted packets, or None for any.

    Raises:
        InputError: no single source, or a budget or a rate that is not positive.
    """

    data: Path | None = None
    live: Path | dict[str, Any] | None = None
    synthetic: dict[str, Any] | None = None
    layout: str | None = None
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    views: int | None = None
    frames: int | None = None
    downscale: float = 1.0
    preset: str = "balanced"
    device: str = "auto"
    seed: int = 0
    points: str = "auto"
    keyframe_interval: int = 100
    frame_budget_ms: float | None = None
    target_kbps: float | None = None

    def __post_init__(self) -> None:
        if sum(getattr(self, name) is not None for name in SOURCES) != 1:
            raise InputError("what to train", "name one source: data, live or synthetic")
        for name in ("frame_budget_ms", "target_kbps"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(name, f"must be positive, not {value}")

    def to_json(self) -> dict[str, Any]:
        """Plain values; `job_from_json` goes back."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


JOB_FIELDS = frozenset(field.name for field in fields(TrainJob))


def job_from_json(values: dict[str, Any]) -> TrainJob:
    """The job with these fields, all of them of `JOB_FIELDS`.

    Raises:
        InputError: no single source.
    """
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    for name in ("data", "live"):
        if isinstance(values.get(name), str):
            values[name] = Path(values[name])
    return TrainJob(**values)
