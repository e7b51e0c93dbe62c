"""The report of a check: one table, one sentence for each finding, and whether anything is at fault."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from streamlod.core.calibration.checks import agreement, clocks, coverage, looks, matches, poses
from streamlod.core.calibration.checks.finding import RigFinding, fault
from streamlod.core.calibration.checks.from_above import drawn_from_above
from streamlod.core.camera import Camera
from streamlod.core.data.lens import Undistortion
from streamlod.core.frames import FrameSet

_MARKS = {"fault": "FAULT", "weak": "weak ", "fact": "     "}
_ORDER = ("fault", "weak", "fact")


@dataclass(frozen=True, slots=True)
class RigCheck:
    """A check's outcome: the table, the findings, the worst first, and what the cameras see, drawn in letters.

    `drawing` is empty where fewer than two cameras gave a picture.
    """

    table: str
    findings: tuple[RigFinding, ...]
    drawing: str

    @property
    def at_fault(self) -> bool:
        """Whether films made so are spoilt."""
        return any(finding.severity == "fault" for finding in self.findings)

    def text(self) -> str:
        """Everything, for people."""
        lines = [f"{_MARKS[finding.severity]} {finding.sentence}" for finding in self.findings]
        end = "the rig has faults" if self.at_fault else "the rig can film"
        return "\n".join([self.table, *([self.drawing] if self.drawing else []), *lines, end])


def examine(
    plans: Sequence[Undistortion], frames: Sequence[FrameSet], times: Mapping[str, clocks.Clock] | None = None
) -> RigCheck:
    """The check of cameras by some instants, in order.

    Args:
        plans: what made the pictures of `frames` fit the cameras.
        times: clocks by camera, where they are known.
    """
    known, cameras = dict(times or {}), [plan.camera for plan in plans]
    of_camera = [[frame.images[number] for frame in frames if frame.present[number]] for number in range(len(cameras))]
    seen = [number for number, pictures in enumerate(of_camera) if pictures]
    found = [looks.look_of(cameras[number].name, of_camera[number]) for number in seen]
    findings = [
        fault(f"{camera.name} gave no picture: see its source and its power")
        for camera, pictures in zip(cameras, of_camera, strict=True)
        if not pictures
    ]
    findings += looks.judged(found)
    if len(known) > 1:
        findings += clocks.judged(list(known.values()))
    best, drawing = np.full(len(cameras), np.nan), ""
    if len(seen) > 1:
        present = [cameras[number] for number in seen]
        # what stands still is the same at all instants, so these need not agree
        pairs = matches.matched([looks.still(of_camera[number]) for number in seen])
        agreed = agreement.agreements(pairs, present)
        findings += poses.judged(agreed, pairs, [plans[number] for number in seen])
        best[seen] = agreement.misses(agreed, len(present))
        covered = coverage.coverage_of(present)
        findings += coverage.judged(covered, present)
        drawing = drawn_from_above(covered, present)
    findings.sort(key=lambda finding: _ORDER.index(finding.severity))
    rows = _rows(cameras, dict(zip(seen, found, strict=True)), known, best.tolist())
    return RigCheck("\n".join(rows), tuple(findings), drawing)


def _rows(
    cameras: Sequence[Camera],
    found: Mapping[int, looks.CameraLook],
    known: Mapping[str, clocks.Clock],
    best: Sequence[float],
) -> Iterator[str]:
    yield (
        f"{'camera':<16}{'size':>11}{'rate':>8}{'lost':>6}{'edge px':>9}{'moving':>8}{'bright':>8}{'white':>7}"
        f"{'match px':>10}"
    )
    for number, camera in enumerate(cameras):
        look, clock = found.get(number), known.get(camera.name)
        rate, lost = ("-", "-") if clock is None else (f"{clock.rate:.2f}", f"{100 * clock.lost:.0f}%")
        seen = ["-"] * 4 if look is None else [
            _number(look.edge), _number(look.moving_edge), f"{look.brightness:.0f}", f"{100 * look.clipped:.0f}%"
        ]  # fmt: skip
        yield (
            f"{camera.name[-15:]:<16}{f'{camera.width}x{camera.height}':>11}{rate:>8}{lost:>6}{seen[0]:>9}{seen[1]:>8}"
            f"{seen[2]:>8}{seen[3]:>7}{_number(best[number]):>10}"
        )


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"
