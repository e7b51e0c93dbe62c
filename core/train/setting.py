"""How a setting of the method is declared: its default, what it means, and what the paper takes for it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeVar

_Value = TypeVar("_Value")
LEFT_OUT = "left out"
"""What the tables show for a setting of a part that a preset does not have."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The choice of the paper for a setting.

    Attributes:
        value: of the field.
        section: of the paper that gives it, empty where we had to read it into the paper.
        why: what the paper says, or why we read it so.
    """

    value: Any
    section: str
    why: str


def setting(
    default: _Value,
    meaning: str,
    paper: Choice,
    *,
    least: float = 0,
    most: float = 10_000_000,
    choices: tuple[str, ...] = (),
) -> _Value:
    """A field of a configuration, with what is said of it in its metadata.

    Args:
        least, most: bounds of a number that is given by name.
        choices: the texts that can be given, where these are few and the type does not tell them.
    """
    told = {"meaning": meaning, "paper": paper, "least": least, "most": most, "choices": choices}
    return field(default=default, metadata=told)


def given(value: Any, section: str, what: str) -> Choice:
    """A value that the paper gives."""
    return Choice(value, section, what)


def octree_gs(value: Any, what: str) -> Choice:
    """A value of Octree-GS, which the paper takes for everything that it does not name (section V-A)."""
    return Choice(value, "V-A", f"the rest is as in Octree-GS: {what}")


def reading(value: Any, why: str) -> Choice:
    """A value that we had to read into the paper."""
    return Choice(value, "", why)


def left_out(instead: str) -> Choice:
    """The choice to have no such mechanism; `instead` says what happens without it."""
    return Choice(LEFT_OUT, "", f"not mentioned: {instead}")
