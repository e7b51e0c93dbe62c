"""Plots of a study: what quality costs, and how it holds over a clip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from client.evaluation.report.figures import Axis, Curve, Dot, curves, scatter
from client.evaluation.report.pareto import pareto_front

COSTS = {
    "predicted_bytes_mean": ("KB a predicted frame", 1000.0),
    "predicted_seconds": ("training seconds a frame", 1.0),
    "render_fps": ("pictures a second", 1.0),
}


def study_plots(name: str, rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """SVG documents of one split by what they show; those without figures, as in a clip of one frame, are left out.

    Args:
        name: of the split. rows: entries of the report.
    """
    plots = {}
    for key, (label, scale) in COSTS.items():
        known = [row for row in rows if row["summary"][key] is not None]
        if not known:
            continue
        costs = [row["summary"][key]["mean"] / scale for row in known]
        quality = [row["summary"]["psnr"]["mean"] for row in known]
        sign = -1 if key == "render_fps" else 1  # speed is no cost
        front = pareto_front([(sign * cost, value) for cost, value in zip(costs, quality, strict=True)])
        dots = [Dot(row["name"], costs[n], quality[n], n in front) for n, row in enumerate(known)]
        plots[key] = scatter(f"{name}: PSNR against {label}", Axis(label, min(costs) > 0), Axis("PSNR dB"), dots)
    over_time = [
        Curve(row["name"], tuple((frame["frame"], frame["psnr"]) for frame in row["seeds"][0]["per_frame"]))
        for row in rows
    ]
    plots["frames"] = curves(f"{name}: PSNR by frame (first seed)", Axis("frame"), Axis("PSNR dB"), over_time)
    return plots
