"""The outcome of one check."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How a check ended, from best to worst."""

    OK = "ok"
    ABSENT = "absent"  # an optional part that is not here
    WARNING = "warning"  # works, but worse than it could
    FAULT = "fault"  # something that was asked for does not work


@dataclass(frozen=True, slots=True)
class Finding:
    """One row of the report.

    Attributes:
        check: what was looked at, for example ``backend cuda``.
        verdict: how it ended.
        found: what is there, with its units.
        remedy: what to do where the verdict is not `Verdict.OK`; empty otherwise.
    """

    check: str
    verdict: Verdict
    found: str
    remedy: str = ""

    def to_json(self) -> dict[str, str]:
        """Plain values, for ``--json``."""
        return {name: str(value) for name, value in asdict(self).items()}
