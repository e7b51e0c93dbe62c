"""The preset `paper`: what the paper takes for every setting of `core.train.config`, and where each comes from.

Nothing is taken from our defaults, so that tuning ours never moves the baseline. docs/preset-paper.md shows the table;
a test compares the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from streamlod.core.train.config import KeyframeConfig, ModelConfig, PartSettings, PredictConfig, TrainConfig
from streamlod.core.train.later_frame.parts import USUAL
from streamlod.core.train.paper.growth import PaperGrowth
from streamlod.core.train.setting import LEFT_OUT

_PARTS = {"model": ModelConfig, "keyframe": KeyframeConfig, "predict": PredictConfig}
OF_LATER_FRAMES: tuple[PartSettings, ...] = (PaperGrowth(),)  # instead of ours


def paper() -> TrainConfig:
    """The configuration of the paper."""
    return TrainConfig(**{name: part(**_values(part)) for name, part in _PARTS.items()}, parts=OF_LATER_FRAMES, seed=0)


def paper_table() -> str:
    """Every setting as a table in Markdown: what it means, our default, and the paper's value with its source."""
    head = ["setting", "meaning", "default", "paper", "source", "what it says, or why we read it so"]
    return "\n".join(map(_row, [head, ["---"] * len(head), *_rows()])) + "\n"


def _rows() -> Iterator[list[str]]:
    for name, settings in _PARTS.items():
        yield from _rows_of(name, settings, is_ours=True)
    for ours in USUAL:
        yield from _rows_of(ours.name, type(ours), is_ours=True)
    for theirs in OF_LATER_FRAMES:
        yield from _rows_of(theirs.name, type(theirs), is_ours=False)


def _rows_of(name: str, settings: type[Any], *, is_ours: bool) -> Iterator[list[str]]:
    for field in fields(settings):
        choice = field.metadata["paper"]
        source = f"section {choice.section}" if choice.section else "our reading"
        default = f"{field.default}" if is_ours else LEFT_OUT
        yield [f"`{name}.{field.name}`", field.metadata["meaning"], default, f"{choice.value}", source, choice.why]


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _values(part: type[ModelConfig | KeyframeConfig | PredictConfig]) -> dict[str, Any]:
    return {field.name: field.metadata["paper"].value for field in fields(part)}
