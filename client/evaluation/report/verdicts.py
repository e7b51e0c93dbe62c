"""Compares the effect of each ablation with the published one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from streamlod.client.evaluation.report.quoted import ABLATIONS, MEET_ROOM, Quoted, QuotedAblation
from streamlod.client.evaluation.report.tables import number, table

_MIN_DB, _MIN_RATIO = 0.05, 0.02  # smaller differences count as none, whatever their spread


@dataclass(frozen=True, slots=True)
class Effect:
    """Differences of a row from its base: PSNR in dB, the others as ratios; None where one is not known.

    `bytes` are those of a predicted frame, `stream` those of a frame of a stream with its keyframes.
    """

    psnr: float
    bytes: float | None
    seconds: float | None
    fps: float | None
    stream: float | None = None


def _published(without: Quoted | QuotedAblation, whole: Quoted | QuotedAblation) -> Effect:
    return Effect(
        without.psnr - whole.psnr,
        without.megabytes / whole.megabytes,
        without.seconds / whole.seconds,
        without.fps / whole.fps,
    )


_ROWS = {row.name: row for row in ABLATIONS}
_FIVE, _THREE = _ROWS["5 views, full"], _ROWS["3 views, full"]
_STARS = {row.method: row for row in MEET_ROOM if row.views == 3}
PUBLISHED = {
    "no quantisation": _published(_ROWS["5 views, without quantisation"], _FIVE),
    "no partition": _published(_ROWS["5 views, without the partition"], _FIVE),
    "one level": _published(_ROWS["5 views, without levels of detail"], _FIVE),
    "no dropout": _published(_ROWS["3 views, without dropout"], _THREE),
    "ours star": _published(_STARS["StreamLoD-GS star"], _STARS["StreamLoD-GS"]),
    "paper star": _published(_STARS["StreamLoD-GS star"], _STARS["StreamLoD-GS"]),
}


def verdict_table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: each row's difference from ours (paper star's from paper), over seeds, and the published one.

    A difference of the paired runs counts when it exceeds its standard error; with one seed, when it exceeds 0.3 dB or
    a tenth, what first frames of one system differ by at least.
    """
    by_name = {row["name"]: row for row in rows}
    body = []
    for row in rows:
        base = by_name.get("paper" if row["name"] == "paper star" else "ours")
        if base is None or row is base:
            continue
        pairs = paired(base["seeds"], row["seeds"])
        if not pairs:
            continue
        published = PUBLISHED.get(row["name"])
        cells = [row["name"]]
        for name in ("psnr", "bytes", "stream", "seconds", "fps"):
            values = [value for pair in pairs if (value := getattr(pair, name)) is not None]
            cells.append(_cell(name, values, None if published is None else getattr(published, name)))
        body.append(cells)
    return table(
        ("system", "PSNR dB", "bytes a predicted frame", "bytes a frame of a stream", "CPU seconds a frame", "fps"),
        body,
    )


def paired(base: Sequence[dict[str, Any]], other: Sequence[dict[str, Any]]) -> list[Effect]:
    """Differences of the runs with the same seed."""
    by_seed = {run["seed"]: run for run in base}
    found = []
    for run in other:
        reference = by_seed.get(run["seed"])
        if reference is not None:
            ratios = (
                _ratio(run[key], reference[key])
                for key in ("predicted_bytes_mean", "predicted_cpu_seconds", "render_fps", "stream_bytes")
            )
            found.append(Effect(run["psnr"] - reference["psnr"], *ratios))
    return found


def agrees(name: str, values: Sequence[float], published: float) -> bool | None:
    """Whether measured differences point where the published one does; None where either is too small to tell."""
    neutral, least, alone = (0.0, _MIN_DB, 0.3) if name == "psnr" else (1.0, _MIN_RATIO, 0.1)
    mean = sum(values) / len(values)
    error = alone
    if len(values) > 1:
        variance = sum((value - mean) ** 2 for value in values) / (len(values) - 1)
        error = math.sqrt(variance / len(values))
    ours, theirs = mean - neutral, published - neutral
    if abs(ours) <= max(error, least) or abs(theirs) <= least:
        return None
    return ours * theirs > 0


def _cell(name: str, values: Sequence[float], published: float | None) -> str:
    if not values:
        return "-"
    mean = sum(values) / len(values)
    text = f"{mean:+.2f}" if name == "psnr" else f"x {number(mean)}"
    if published is None:
        return text
    theirs = f"{published:+.2f}" if name == "psnr" else f"x {number(published)}"
    if name == "fps":  # wall time on another machine: not comparable
        return f"{text} ({theirs})"
    verdict = {True: "as published", False: "**against**", None: "no telling"}[agrees(name, values, published)]
    return f"{text} ({theirs}: {verdict})"


def _ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None
