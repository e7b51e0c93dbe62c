"""The preset `paper`: what the paper takes for every setting of `core.train.config`, and where each comes from.

Nothing is taken from our defaults, so that tuning ours never moves the baseline. docs/preset-paper.md shows the table;
a test compares the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from streamlod.core.train.config import KeyframeConfig, ModelConfig, PredictConfig, TrainConfig

_PARTS = {"model": ModelConfig, "keyframe": KeyframeConfig, "predict": PredictConfig}


def paper() -> TrainConfig:
    """The configuration of the paper."""
    return TrainConfig(**{name: part(**_values(part)) for name, part in _PARTS.items()}, seed=0)


def paper_table() -> str:
    """Every setting as a table in Markdown: what it means, our default, and the paper's value with its source."""
    head = ["setting", "meaning", "default", "paper", "source", "what it says, or why we read it so"]
    return "\n".join(map(_row, [head, ["---"] * len(head), *_rows()])) + "\n"


def _rows() -> Iterator[list[str]]:
    for name, part in _PARTS.items():
        for field in fields(part):
            choice = field.metadata["paper"]
            source = f"section {choice.section}" if choice.section else "our reading"
            meaning = field.metadata["meaning"]
            yield [f"`{name}.{field.name}`", meaning, f"{field.default}", f"{choice.value}", source, choice.why]


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _values(part: type[ModelConfig | KeyframeConfig | PredictConfig]) -> dict[str, Any]:
    return {field.name: field.metadata["paper"].value for field in fields(part)}
