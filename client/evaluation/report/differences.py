"""Differences of each system of a study from its base, over runs with the same seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from streamlod.client.evaluation.report.tables import number, table


@dataclass(frozen=True, slots=True)
class Effect:
    """Differences of a run from its base: PSNR in dB, the others as ratios; None where one is not known.

    `bytes` are those of a predicted frame, `stream` those of a frame of a stream with its keyframes.
    """

    psnr: float
    bytes: float | None
    seconds: float | None
    fps: float | None
    stream: float | None


def differences_table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: each row's mean difference from ours over the seeds that both have; paper star's from paper, and so
    called."""
    by_name = {row["name"]: row for row in rows}
    body = []
    for row in rows:
        is_star = row["name"] == "paper star"
        base = by_name.get("paper" if is_star else "ours")
        if base is None or row is base:
            continue
        pairs = paired(base["seeds"], row["seeds"])
        if pairs:
            columns = ("psnr", "bytes", "stream", "seconds", "fps")
            name = f"{row['name']}, from paper" if is_star else row["name"]
            body.append([name, *(_cell(column, pairs) for column in columns)])
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


def _cell(name: str, pairs: Sequence[Effect]) -> str:
    values = [value for pair in pairs if (value := getattr(pair, name)) is not None]
    if not values:
        return "-"
    mean = sum(values) / len(values)
    return f"{mean:+.2f}" if name == "psnr" else f"x {number(mean)}"


def _ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None
