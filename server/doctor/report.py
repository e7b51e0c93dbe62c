"""The findings as one table with a verdict, or as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from streamlod.server.doctor.backends import check_backends
from streamlod.server.doctor.finding import Finding, Verdict
from streamlod.server.doctor.host import check_host
from streamlod.server.doctor.versions import check_versions

_ORDER = list(Verdict)
_SENTENCES = {
    Verdict.OK: "This machine can do everything.",
    Verdict.ABSENT: "This machine can do what was asked for; optional parts are absent.",
    Verdict.WARNING: "This machine works, with the warnings above.",
    Verdict.FAULT: "Something that was asked for does not work: see the faults above.",
}


def examine(device: str, host: str, port: int, state: Path | None, quick: bool) -> list[Finding]:
    """All findings, cheap ones first.

    Args:
        device: ``auto``, ``cpu`` or ``cuda``; a backend that was asked for by name has to work.
        host, port, state: of the service that is to run here.
        quick: leave out what takes more than a few seconds.
    """
    return [*check_versions(), *check_host(host, port, state), *check_backends(device, quick)]


def worst(findings: Sequence[Finding]) -> Verdict:
    """The most serious verdict among `findings`."""
    return max((finding.verdict for finding in findings), key=_ORDER.index)


def as_table(findings: Sequence[Finding]) -> str:
    """A line a finding, remedies below their finding, and the verdict in one sentence."""
    width = max(len(finding.check) for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{finding.check:<{width}}  {finding.verdict:<7}  {finding.found}")
        if finding.remedy:
            lines.append(f"{'':<{width}}  {'':<7}  -> {finding.remedy}")
    return "\n".join([*lines, "", _SENTENCES[worst(findings)]])


def as_json(findings: Sequence[Finding]) -> str:
    """The same as JSON: `verdict` and `findings`."""
    return json.dumps({"verdict": worst(findings), "findings": [finding.to_json() for finding in findings]}, indent=1)
