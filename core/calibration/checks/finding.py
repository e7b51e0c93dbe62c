"""Findings of a check."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
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


fault = partial(RigFinding, "fault")
weak = partial(RigFinding, "weak")
fact = partial(RigFinding, "fact")
