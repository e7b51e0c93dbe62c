"""A sweep of the settings, and the Pareto fronts of quality against seconds, bytes and rendering cost."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from streamlod.client.evaluation.design import BASE, Point, one_at_a_time
from streamlod.client.evaluation.measure.footage import (
    Footage,
    chosen_split,
    footage_frames,
    open_footage,
    pictures_digest,
)
from streamlod.client.evaluation.measure.machine import machine
from streamlod.client.evaluation.options import TradeoffOptions
from streamlod.client.evaluation.report.output import result_folder, write_json
from streamlod.client.evaluation.report.pareto import pareto_front
from streamlod.client.evaluation.report.plots import cost_plot
from streamlod.client.evaluation.report.tables import number, table
from streamlod.client.evaluation.resume import as_json, earlier_report, missing_seeds, with_earlier
from streamlod.client.evaluation.summary import mean, run_figures
from streamlod.client.evaluation.systems import FirstFrames, SystemRun, run_system
from streamlod.core.data.names import counted
from streamlod.core.files import write_text

_log = logging.getLogger(__name__)
SCHEMA = 6


@dataclass(frozen=True, slots=True)
class Cost:
    """One cost of quality: its key in the figures, its name and unit, and a scale for tables."""

    key: str
    label: str
    scale: float = 1.0


COSTS = (
    Cost("predicted_seconds", "training seconds a frame"),
    Cost("first_frame_seconds", "first frame seconds"),
    Cost("predicted_cpu_seconds", "CPU seconds a frame"),
    Cost("first_frame_cpu_seconds", "first frame CPU seconds"),
    Cost("predicted_bytes_mean", "KB a predicted frame", 1000),
    Cost("keyframe_bytes", "KB a keyframe", 1000),
    Cost("stream_bytes", "KB a frame of a stream", 1000),
    Cost("render_milliseconds", "rendering milliseconds a picture"),
)
_MEASURED = ("psnr", "ssim", "anchors", *(cost.key for cost in COSTS))


def run_tradeoff(data: Path, out: Path, options: TradeoffOptions, points: Sequence[Point] = ()) -> str:
    """Measure and write `tradeoff.json` (points and fronts), `tradeoff.md` and plots into `out`; returns a sentence.

    The figures are written after every run, all points with one seed before the next seed, and the plots at the end, so
    that a sweep that is stopped leaves what it has measured. Runs that `out` holds already stay in the report, those of
    other points too, and are not measured again.

    Args:
        points: configurations to measure instead of the design's.

    Raises:
        InputError: unusable data, or options that do not fit them.
    """
    points = points or one_at_a_time()
    split = chosen_split(data, options.split, options.views, options.test, options.downscale)
    out = result_folder(out)
    footages: dict[float, tuple[Footage, FirstFrames]] = {}
    value: dict[str, Any] = {
        "schema": SCHEMA,
        "data": data.resolve().name,
        "pictures": pictures_digest(data),
        "machine": machine(options.device),
        "base": BASE,
        "split": {"name": split.name, "train": list(split.train), "test": list(split.test)},
        "downscale": options.downscale,
        "frames": footage_frames(data, options.frames),
        "points": [],
        "fronts": {},
    }
    facts = {key: value[key] for key in ("schema", "pictures", "machine", "split", "downscale", "frames")}
    earlier = earlier_report(out / "tradeoff.json", facts).get("points", [])
    entries = with_earlier(
        [_entry(point) for point in points], earlier, "runs", lambda entry: [entry["config"], entry["shrink"]]
    )
    try:
        for seed, (row, point) in itertools.product(range(options.seeds), enumerate(points)):
            if seed in missing_seeds(entries[row], "runs", options.seeds):
                if point.shrink not in footages:
                    trained_at = options.downscale * point.shrink
                    footage = open_footage(
                        data, split, frames=options.frames, downscale=trained_at, test_downscale=options.downscale
                    )
                    footages[point.shrink] = footage, FirstFrames(options.device)
                found = _figures(run_system(replace(point.config, seed=seed), *footages[point.shrink]))
                _log.info("%s, seed %d: %.2f dB", point.name, seed, found["psnr"])
                entries[row] = {**entries[row], "runs": [*entries[row]["runs"], found]}
            value["points"] = [_means(measured) for measured in entries if measured["runs"]]
            value["fronts"] = fronts(value["points"])
            _write(out, value)
    finally:
        _draw(out, value)
    front = value["fronts"][COSTS[0].key]
    return f"{out / 'tradeoff.md'}: {len(value['points'])} points, {len(front)} on the front of seconds"


def _entry(point: Point) -> dict[str, Any]:
    """A point's entry in the report, before any run."""
    config = as_json(asdict(point.config))
    return {"name": point.name, "knob": point.knob, "shrink": point.shrink, "config": config, "runs": []}


def _means(entry: dict[str, Any]) -> dict[str, Any]:
    """An entry with the means of its runs' figures, and the spread of their PSNR."""
    runs = entry["runs"]
    means = {key: mean(run[key] for run in runs) for key in _MEASURED}
    deviation = float(np.std([run["psnr"] for run in runs], ddof=1)) if len(runs) > 1 else 0.0
    return {**entry, **means, "psnr_spread": deviation}


def _figures(run: SystemRun) -> dict[str, Any]:
    figures = run_figures(run)
    figures["render_milliseconds"] = 1000 / figures["render_fps"]
    return {key: figures[key] for key in ("seed", *_MEASURED)}


def _write(out: Path, value: dict[str, Any]) -> None:
    write_json(out / "tradeoff.json", value)
    write_text(out / "tradeoff.md", tradeoff_report(value))


def _draw(out: Path, value: dict[str, Any]) -> None:
    for cost in COSTS:
        points = [
            (point["name"], point[cost.key] / cost.scale, point["psnr"])
            for point in value["points"]
            if point[cost.key] is not None
        ]
        if points:
            write_text(out / f"{cost.key}.svg", cost_plot(value["data"], cost.label, points))


def fronts(points: Sequence[dict[str, Any]]) -> dict[str, list[str]]:
    """Names of the points, for each cost, on the front of PSNR against it, by rising cost."""
    found = {}
    for cost in COSTS:
        known = [point for point in points if point[cost.key] is not None]
        rows = pareto_front([(point[cost.key], point["psnr"]) for point in known])
        found[cost.key] = [known[row]["name"] for row in rows]
    return found


def beaten_by(point: dict[str, Any], points: Sequence[dict[str, Any]]) -> list[str]:
    """Names of the points that are better than `point`, and take neither more training time a frame nor more bytes."""
    keys = ("predicted_seconds", "predicted_bytes_mean")
    if any(point[key] is None for key in keys):
        return []
    return [
        other["name"]
        for other in points
        if other["psnr"] > point["psnr"] and all(other[key] <= point[key] for key in keys)
    ]


def tradeoff_report(value: dict[str, Any]) -> str:
    """Markdown of the value that is written as JSON."""
    host, split = value["machine"], value["split"]
    on_front = {name for front in value["fronts"].values() for name in front}
    runs = max((len(point["runs"]) for point in value["points"]), default=0)
    many = f"means of {runs} seeds; ± is the standard deviation of the PSNR"
    seeds = many if runs > 1 else "one seed, so differences of 0.1 dB say nothing"
    head = ("point", "PSNR dB", "SSIM", *(cost.label for cost in COSTS), "anchors", "on a front")
    body = [
        [
            point["name"],
            f"{number(point['psnr'])} ± {number(point['psnr_spread'])}" if runs > 1 else number(point["psnr"]),
            number(point["ssim"], 4),
            *(number(point[cost.key], 2, cost.scale) for cost in COSTS),
            f"{point['anchors']:.0f}",
            "yes" if point["name"] in on_front else "",
        ]
        for point in value["points"]
    ]
    accelerator = f", {host['accelerator']}" if host["accelerator"] else ""
    lines = [
        f"# Price of quality on {value['data']}",
        "",
        f"{host['processor']}, {host['cores']} cores{accelerator}; {counted(value['frames'], 'frame')}; "
        f"split {split['name']}, held out {', '.join(split['test'])}. "
        f"One setting at a time away from the preset {value['base']}; {seeds}. "
        "Held-out pictures keep their size whatever the training pictures' is.",
        "",
        table(head, body),
        "## Fronts",
        "",
        *(f"- PSNR against {cost.label}: {', '.join(value['fronts'][cost.key]) or 'none'}" for cost in COSTS),
        "",
        "## Presets",
        "",
        *(_preset_line(point, value["points"]) for point in value["points"] if point["knob"] == "preset"),
        "",
        *(f"![PSNR against {cost.label}]({cost.key}.svg)" for cost in COSTS if value["fronts"][cost.key]),
        "",
    ]
    return "\n".join(lines)


def _preset_line(point: dict[str, Any], points: Sequence[dict[str, Any]]) -> str:
    better = beaten_by(point, points)
    best = "no other point has a higher PSNR at no more seconds and bytes a frame"
    verdict = f"beaten by {', '.join(better)}" if better else best
    return f"- {point['name']}: {verdict}"
