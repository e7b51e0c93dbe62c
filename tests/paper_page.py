"""Prints docs/preset-paper.md from the settings of the method: `python -m tests.paper_page`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from streamlod.core.train import KeyframeConfig, ModelConfig, PredictConfig
from streamlod.core.train.later_frame.parts import USUAL
from streamlod.core.train.paper.preset import OF_LATER_FRAMES
from streamlod.core.train.setting import LEFT_OUT

PAGE = Path(__file__).parents[1] / "docs" / "preset-paper.md"
HEAD = """# The preset `paper`

Every setting of the method: what it means, its default, what the paper takes (the preset `paper`), and where that comes
from. The fields of `core/train/config.py` and of the parts of later frames (`core/train/later_frame/parts`,
`core/train/paper/growth.py`) hold all of it. `streamlod train --set NAME=VALUE` changes any of them. `make api` prints
this page.

`parts` names the parts of later frames that take part, in their order, as in `--set parts=flow_search+new_anchors`;
what is left out here has settings once it is named.

"""


def page() -> str:
    """The page: every setting with its meaning, our default, and the paper's value with its source."""
    head = ["setting", "meaning", "default", "paper", "source", "what it says, or why we read it so"]
    return HEAD + "\n".join(map(_row, [head, ["---"] * len(head), *_rows()])) + "\n"


def _rows() -> Iterator[list[str]]:
    for name, settings in (("model", ModelConfig), ("keyframe", KeyframeConfig), ("predict", PredictConfig)):
        yield from _rows_of(name, settings, is_ours=True)
    for ours in USUAL:
        yield from _rows_of(ours.name, type(ours), is_ours=True)
    for theirs in OF_LATER_FRAMES:
        yield from _rows_of(theirs.name, type(theirs), is_ours=False)


def _rows_of(name: str, settings: type[Any], *, is_ours: bool) -> Iterator[list[str]]:
    for field in fields(settings):
        choice = field.metadata["paper"]
        source = f"section {choice.section}" if choice.section else "our reading"
        default = field.default if is_ours else LEFT_OUT
        cells = [field.metadata["meaning"], _as_given(default), _as_given(choice.value), source, choice.why]
        yield [f"`{name}.{field.name}`", *cells]


def _as_given(value: Any) -> str:
    """A value as `--set` takes it."""
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
