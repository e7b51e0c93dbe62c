"""The systems that a study compares: one row of its tables each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from core.errors import InputError
from core.train import PredictConfig, TrainConfig, preset
from core.train.config import LevelSelection

ABLATIONS = ("lod", "partition", "quantisation", "dropout", "star", "cue")
LEFT_OUT = {"heads": "the trainer has one network for all outputs, so separate heads cannot be switched on"}
_FINER = 16  # rounding to a 16th of a step changes nothing that a picture shows


@dataclass(frozen=True, slots=True)
class Row:
    """One system.

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
        ablations: of `ABLATIONS`; ``all`` stands for every one; those of `LEFT_OUT` are passed over.

    Raises:
        InputError: an unknown preset or ablation.
    """
    ours, paper = preset(preset_name), preset("paper")
    wanted = ABLATIONS if "all" in ablations else tuple(name for name in ablations if name not in LEFT_OUT)
    unknown = sorted(set(wanted) - set(ABLATIONS))
    if unknown:
        raise InputError(
            "--ablate", f"{', '.join(unknown)}: unknown; choose of all, {', '.join((*ABLATIONS, *LEFT_OUT))}"
        )
    unbounded = unquantised(replace(ours, predict=replace(ours.predict, everything=True)))
    return (
        Row("ours", f"preset {preset_name}", ours),
        Row("paper", "preset paper", paper),
        Row("paper star", "partition every 4 frames, posterior 0.9", _star(paper)),
        *(row for name in ABLATIONS if name in wanted for row in _ablation(name, ours)),
        Row("frozen", "bound from below: the first frame only", ours, frozen=True),
        Row("full", "bound from above: every anchor trained every frame, unquantised, no rate term", unbounded),
    )


def unquantised(config: TrainConfig) -> TrainConfig:
    """The same training with steps so fine that rounding has no effect, and without the rate term.

    Rates are in steps, so they grow as the steps shrink: parameters move as before.
    """
    predict = config.predict
    finer = replace(
        predict,
        feature_step=predict.feature_step / _FINER,
        offset_step=predict.offset_step / _FINER,
        position_steps_per_cell=predict.position_steps_per_cell * _FINER,
        latent_rate=predict.latent_rate * _FINER,
        position_rate=predict.position_rate * _FINER,
        rate_weight=0.0,
    )
    return replace(config, predict=finer)


def _ablation(name: str, ours: TrainConfig) -> tuple[Row, ...]:
    model, keyframe, predict = ours.model, ours.keyframe, ours.predict

    def later(row: str, note: str, changed: PredictConfig) -> Row:
        return Row(row, note, replace(ours, predict=changed))

    found: tuple[Row, ...]
    if name == "lod":
        other: LevelSelection = "distance" if model.selection == "all" else "all"
        uncapped = replace(keyframe, level_cap_share=0.0)
        found = (
            Row("one level", "no octree", replace(ours, model=replace(model, levels=1, finer_levels=0))),
            Row(f"levels by {other}", f"selection {other}", replace(ours, model=replace(model, selection=other))),
            Row("no level caps", "never trained with fine levels hidden", replace(ours, keyframe=uncapped)),
        )
        return _changed(found, ours)
    if name == "partition":
        return (later("no partition", "every anchor dynamic", replace(predict, everything=True)),)
    if name == "quantisation":
        return (Row("no quantisation", f"steps {_FINER} times finer, no rate term", unquantised(ours)),)
    if name == "dropout":
        without = replace(keyframe, dropout_base=0.0, dropout_slope=0.0)
        theirs = preset("paper").keyframe
        as_paper = replace(keyframe, dropout_base=theirs.dropout_base, dropout_slope=theirs.dropout_slope)
        found = (
            Row("no dropout", "first frame without dropout", replace(ours, keyframe=without)),
            Row("dropout of the paper", "first frame with the paper's dropout", replace(ours, keyframe=as_paper)),
        )
        return _changed(found, ours)
    if name == "star":
        return (Row("ours star", "partition every 4 frames, posterior 0.9", _star(ours)),)
    return tuple(
        later(f"cue {cue}", f"motion cue {cue}", replace(predict, cue=cue))
        for cue in ("difference", "previous", "canonical")
        if cue != predict.cue
    )


def _changed(rows: tuple[Row, ...], ours: TrainConfig) -> tuple[Row, ...]:
    """Those that are not ours by another name."""
    return tuple(row for row in rows if row.config != ours)


def _star(config: TrainConfig) -> TrainConfig:
    """The paper's faster variant (section IV): a partition every fourth frame at a posterior of 0.9."""
    return replace(config, predict=replace(config.predict, partition_interval=4, posterior=0.9))
