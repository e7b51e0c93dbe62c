"""Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence

_NOT_MEASURED = "-"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is text, the others are numbers."""
    rule = ["---"] + ["---:"] * (len(head) - 1)
    lines = [head, rule, *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def number(value: float | None, digits: int = 2, scale: float = 1.0) -> str:
    """`value` / `scale` with so many digits; a dash where nothing was measured."""
    return _NOT_MEASURED if value is None else f"{value / scale:.{digits}f}"


def spread_number(value: dict[str, float] | None, digits: int = 2, scale: float = 1.0) -> str:
    """Mean, and the spread over seeds where there is one."""
    if value is None:
        return _NOT_MEASURED
    text = number(value["mean"], digits, scale)
    return f"{text} ± {number(value['spread'], digits, scale)}" if value["spread"] else text
