"""The Markdown report of a study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from streamlod.client.evaluation.measure.moving import MOVING_METRICS
from streamlod.client.evaluation.measure.places import PLACE_HEADINGS, PLACES
from streamlod.client.evaluation.measure.scores import METRICS
from streamlod.client.evaluation.measure.sizes import KEYFRAME_INTERVAL
from streamlod.client.evaluation.report.differences import differences_table
from streamlod.client.evaluation.report.tables import number, spread_number, table
from streamlod.core.data.names import counted

_QUALITY = ("system", *(metric.heading for metric in (*METRICS, *MOVING_METRICS)))
_PLACES = ("system", *PLACE_HEADINGS)
_COST = (
    "system",
    "key KB",
    "P mean KB",
    "P max KB",
    "stream KB",
    "stream kbps",
    "key est. KB",
    "P est. KB",
    "first CPU s",
    "frame CPU s",
    "frame s",
    "fps",
    "MB",
)
_CUT = (("keyframe_bytes", "keyframe_level_bytes"), ("predicted_bytes_mean", "predicted_level_bytes"))
_MOTION = ("system", "dynamic %", "precision", "recall")


def study_report(study: dict[str, Any]) -> str:
    """Markdown of the value that `client.evaluation.study` writes as JSON."""
    host, protocol = study["machine"], study["protocol"]
    cores = f"{host['processor']}, {host['cores']} cores" + (f", {host['accelerator']}" if host["accelerator"] else "")
    lines = [
        f"# Study of {study['data']}",
        "",
        f"Measured on {cores}; {counted(protocol['frames'], 'frame')}, downscale {protocol['downscale']:g}, seeds "
        f"{', '.join(map(str, study['seeds']))}. Held-out cameras only; every system of a split starts from the "
        "same first points. Figures are means over frames and held-out cameras, then mean ± standard deviation over "
        "seeds. "
        "Bytes are real packets (P: predicted frames; stream: mean over a stream in which every frame is predicted and "
        f"every {KEYFRAME_INTERVAL}th comes as a keyframe as well); 'est.' is Shannon's zeroth-order estimate, as "
        "papers report it. "
        "Moving pixels are those of surfaces that move in this step, dilated (on real video: pixels that change). "
        "Rendering includes the expansion of all anchors and runs on the processor. CPU seconds are those of "
        "all threads, the others wall time. LPIPS is measured on up to "
        f"{protocol['lpips_frames']} frames of a clip. MB is the peak memory of the process while a system trains and "
        "is measured, pictures of other systems included.",
        "",
    ]
    for split in study["splits"]:
        lines += _split(split)
    return "\n".join(lines)


def _split(split: dict[str, Any]) -> list[str]:
    rows = split["rows"]
    lines = [
        f"## {split['name']}",
        "",
        f"Trained on {', '.join(split['train'])}; held out {', '.join(split['test'])}; {split['points']} first points.",
        "",
        table(_QUALITY, [_quality(row) for row in rows]),
        table(_PLACES, [_places(row) for row in rows]),
        table(_COST, [_cost(row) for row in rows]),
    ]
    if any(row["summary"]["motion_recall"] for row in rows):
        lines += [
            "Dynamic anchors against true motion:",
            "",
            table(_MOTION, [_motion(row) for row in rows]),
        ]
    lines += ["Differences from ours, means of runs with the same seed:", ""]
    lines += [differences_table(rows)]
    lines += ["Seconds by stage, first frame and a later frame:", "", _stages(rows)]
    lines += ["The last frame with its coarsest levels only (first seed):", "", _caps(rows)]
    lines += [f"- **{row['name']}**: {row['note']}" for row in rows] + [""]
    lines += [f"![{plot}]({plot})" for plot in split["plots"]] + [""]
    lines += [f"![{row['name']}: truth, rendering, difference x4]({row['picture']})" for row in rows] + [""]
    return lines


def _quality(row: dict[str, Any]) -> list[str]:
    figures = row["summary"]
    return [
        row["name"],
        *(spread_number(figures[metric.field], metric.digits) for metric in (*METRICS, *MOVING_METRICS)),
    ]


def _places(row: dict[str, Any]) -> list[str]:
    """Where viewers stand, first frame."""
    return [row["name"], *(spread_number(row["summary"].get(name)) for name in PLACES)]


def _cost(row: dict[str, Any]) -> list[str]:
    figures = row["summary"]
    sizes = ("keyframe_bytes", "predicted_bytes_mean", "predicted_bytes_max")
    stream = (spread_number(figures["stream_bytes"], 2, 1000), spread_number(figures["stream_kbps"], 0))
    estimates = ("shannon_keyframe_bytes", "shannon_predicted_bytes")
    return [
        row["name"],
        *(spread_number(figures[name], 2, 1000) for name in sizes),
        *stream,
        *(spread_number(figures[name], 2, 1000) for name in estimates),
        spread_number(figures["first_frame_cpu_seconds"], 1),
        spread_number(figures["predicted_cpu_seconds"], 2),
        spread_number(figures["predicted_seconds"], 2),
        spread_number(figures["render_fps"], 1),
        spread_number(figures["peak_bytes"], 0, 1e6),
    ]


def _motion(row: dict[str, Any]) -> list[str]:
    figures = row["summary"]
    return [
        row["name"],
        spread_number(figures["dynamic_share"], 1, 0.01),
        spread_number(figures["motion_precision"], 3),
        spread_number(figures["motion_recall"], 3),
    ]


def _stages(rows: Sequence[dict[str, Any]]) -> str:
    first = list(dict.fromkeys(stage for row in rows for stage in row["seeds"][0]["first_frame_stages"]))
    later = list(dict.fromkeys(stage for row in rows for stage in row["seeds"][0]["predicted_stages"]))
    head = ["system", *(f"first {stage}" for stage in first), *(f"later {stage}" for stage in later)]
    body = []
    for row in rows:
        run = row["seeds"][0]
        cells = [number(run["first_frame_stages"].get(stage), 2) for stage in first]
        body.append([row["name"], *cells, *(number(run["predicted_stages"].get(stage), 3) for stage in later)])
    return table(head, body)


def _caps(rows: Sequence[dict[str, Any]]) -> str:
    """Quality, bytes and rendering cost of a stream cut at each level."""
    body = []
    for row in rows:
        run = row["seeds"][0]
        for cap in run["caps"]:
            count = cap["levels"]
            sizes = [number(run[whole] - sum(run[levels][count:]), 2, 1000) for whole, levels in _CUT if run[levels]]
            sizes += ["-"] * (len(_CUT) - len(sizes))
            figures = (number(cap["psnr"]), number(cap["ssim"], 4), *sizes, number(cap["render_fps"], 1))
            body.append([row["name"], str(count), *figures])
    return table(("system", "levels", "PSNR dB", "SSIM", "key KB", "P KB", "fps"), body)
