"""Findings of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class RigFinding:
    """A sentence about the rig or one camera.

    Attributes:
        severity: ``fault``: films made so are spoilt; ``weak``: better ones are possible; ``fact``: good to know.
        sentence: what was seen, and what to do.
    """

    severity: Literal["fault", "weak", "fact"]
    sentence: str


def fault(sentence: str) -> RigFinding:
    """A fault."""
    return RigFinding("fault", sentence)


def weak(sentence: str) -> RigFinding:
    """A weakness."""
    return RigFinding("weak", sentence)


def fact(sentence: str) -> RigFinding:
    """A fact."""
    return RigFinding("fact", sentence)
