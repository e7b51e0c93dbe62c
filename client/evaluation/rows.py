"""The systems that a study compares; each is one row of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from streamlod.client.evaluation.systems import with_coarser_steps
from streamlod.core.errors import InputError
from streamlod.core.train import TrainConfig, preset
from streamlod.core.train.config import LevelSelection

ABLATIONS = ("lod", "partition", "quantisation", "dropout", "star", "cue")
_FINER = 16  # rounding to a 16th of a step changes nothing that a picture shows


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a study: one system.

    Attributes:
        name: in the tables. note: what differs from ours.
        config: of the trainer; its seed is set for each run.
        frozen: show the first frame for ever instead of training later ones.
    """

    name: str
    note: str
    config: TrainConfig
    frozen: bool = False


def study_rows(preset_name: str, ablations: Sequence[str]) -> tuple[Row, ...]:
    """Ours (a preset), the paper's, the star variant of it, the ablations asked for, and two bounds.

    Args:
        ablations: of `ABLATIONS`; ``all`` stands for every one.

    Raises:
        InputError: an unknown preset or ablation.
    """
    ours, paper = preset(preset_name), preset("paper")
    wanted = ABLATIONS if "all" in ablations else tuple(ablations)
    unknown = sorted(set(wanted) - set(ABLATIONS))
    if unknown:
        raise InputError("--ablate", f"{', '.join(unknown)}: unknown; choose of all, {', '.join(ABLATIONS)}")
    unbounded = unquantised(replace(ours, predict=replace(ours.predict, cue="everything")))
    return (
        Row("ours", f"preset {preset_name}", ours),
        Row("paper", "preset paper", paper),
        Row("paper star", "partition every 4 frames, posterior 0.9", _every_fourth(paper, 0.9)),
        *(row for name in ABLATIONS if name in wanted for row in _ablation(name, ours)),
        Row("frozen", "bound from below: the first frame only", ours, frozen=True),
        Row("full", "bound from above: every anchor trained every frame, unquantised, no rate term", unbounded),
    )


def unquantised(config: TrainConfig) -> TrainConfig:
    """The same training with steps so fine that rounding has no effect, and without the rate term.

    Rates are in steps, so they grow as the steps shrink: parameters move as before.
    """
    finer = with_coarser_steps(config, 1 / _FINER)
    return replace(finer, predict=replace(finer.predict, rate_weight=0.0))


def _ablation(name: str, ours: TrainConfig) -> tuple[Row, ...]:
    """The rows of one ablation: what ours becomes without a part, or with the paper's choice of it."""
    model, keyframe, predict, paper = ours.model, ours.keyframe, ours.predict, preset("paper")
    other: LevelSelection = "distance" if model.selection == "all" else "all"

    def built(row: str, note: str, **changed: Any) -> Row:
        return Row(row, note, replace(ours, model=replace(model, **changed)))

    def first(row: str, note: str, **changed: Any) -> Row:
        return Row(row, note, replace(ours, keyframe=replace(keyframe, **changed)))

    def later(row: str, note: str, **changed: Any) -> Row:
        return Row(row, note, replace(ours, predict=replace(predict, **changed)))

    theirs = {part: getattr(paper.keyframe, part) for part in ("dropout_base", "dropout_slope")}
    rows: dict[str, tuple[Row, ...]] = {
        "lod": (
            built("one level", "no octree", levels=1, finer_levels=0, cell_pixels=4.0),
            built(f"levels by {other}", f"selection {other}", selection=other),
            first("no level caps", "never trained with fine levels hidden", level_cap_share=0.0),
        ),
        "partition": (later("no partition", "every anchor dynamic", cue="everything"),),
        "quantisation": (Row("no quantisation", f"steps {_FINER} times finer, no rate term", unquantised(ours)),),
        "dropout": (
            first("no dropout", "first frame without dropout", dropout_base=0.0, dropout_slope=0.0),
            first("dropout of the paper", "first frame with the paper's dropout", **theirs),
        ),
        "star": (Row("ours star", "partition every 4 frames", _every_fourth(ours, ours.predict.posterior)),),
        "cue": tuple(later(f"cue {cue}", f"motion cue {cue}", cue=cue) for cue in ("difference", "canonical")),
    }
    return _changed(rows[name], ours)


def _changed(rows: tuple[Row, ...], ours: TrainConfig) -> tuple[Row, ...]:
    """The rows whose configuration differs from ours."""
    return tuple(row for row in rows if row.config != ours)


def _every_fourth(config: TrainConfig, posterior: float) -> TrainConfig:
    """A partition every fourth frame: the paper's faster variant (paper section V-A)."""
    return replace(config, predict=replace(config.predict, partition_interval=4, posterior=posterior))
