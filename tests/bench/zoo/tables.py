"""The zoo's report: a table of rows, means of scenes and halves, what moves, and levels cut away."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from streamlod.client.evaluation.measure.places import PLACE_HEADINGS, PLACES, mean_figure
from streamlod.client.evaluation.report.tables import number, table
from tests.bench.zoo.cells import CellKey, Cells
from tests.bench.zoo.scenes import SCENES

_HALF = {scene.name: scene.half for scene in SCENES}
_ORDER = {scene.name: place for place, scene in enumerate(SCENES)}
_HEAD = (
    "scene",
    "views",
    "seeds",
    "ours dB",
    "SSIM",
    "LPIPS",
    "plain dB",
    "SSIM",
    "LPIPS",
    "ours - plain dB",
    "paper dB",
    "CPU s ours",
    "plain",
    "paper",
    "KB ours",
    "plain as SPZ",
)


@dataclass(frozen=True, slots=True)
class SceneRow:
    """The cells of one scene and number of views, by system, one a seed."""

    scene: str
    views: int
    cells: dict[str, list[dict[str, Any]]]

    def first(self, system: str, figure: str) -> float | None:
        """Mean over the seeds of a figure of the first frame."""
        return _mean(cell["frames"][0].get(figure) for cell in self.cells.get(system, []))

    def place(self, system: str, place: str, figure: str) -> float | None:
        """Mean over the seeds of a figure where viewers stand, as `mean_figure` has it."""
        return _mean(mean_figure(cell["places"], place, figure) for cell in self.cells.get(system, []))

    def later(self, system: str, figure: str) -> float | None:
        """Mean over the seeds of a figure of the last frame, None where there is one frame only."""
        return _mean(cell["frames"][-1].get(figure) for cell in self.cells.get(system, []) if len(cell["frames"]) > 1)

    @property
    def lead(self) -> float | None:
        """How far ours is above plain in the first frame, dB."""
        ours, plain = self.first("ours", "psnr"), self.first("plain", "psnr")
        return None if ours is None or plain is None else ours - plain


def zoo_report(cells: Cells, missing: Sequence[str] = ()) -> str:
    """Markdown of all `cells`, a section for each preset, size and first points; `missing` scenes were not there."""
    groups: dict[tuple[str, float, str], list[tuple[CellKey, dict[str, Any]]]] = defaultdict(list)
    for key, figures in cells.items():
        groups[key.preset, key.downscale, key.points].append((key, figures))
    parts = ["# Zoo", ""]
    if missing:
        parts += [f"Not under the data root, so not measured: {', '.join(missing)}.", ""]
    for (preset, downscale, points), found in groups.items():
        size = f"{downscale:g} times smaller" if downscale >= 1 else f"{1 / downscale:.3g} times larger"
        title = f"## Preset {preset}, pictures {size} than nominal, first points {points}"
        parts += [title, "", *_section(_lines(found))]
    return "\n".join(parts)


def _section(lines: Sequence[SceneRow]) -> list[str]:
    parts = [
        "Held-out camera, first frame, means over seeds; plain is trained for the CPU seconds that ours took.",
        "",
    ]
    for half in ("choosing", "reporting"):
        inside = [line for line in lines if _HALF[line.scene] == half]
        if inside:
            rows = [_row(line) for line in inside] + [_mean_row(f"mean of the {half} half", inside)]
            parts += [f"### {half.capitalize()} half", "", table(_HEAD, rows)]
    parts += ["### Where viewers stand, first frame", "", table(*_places(lines))]
    moving = [line for line in lines if line.later("ours", "psnr") is not None]
    if moving:
        parts += ["### First and last frame", "", table(*_moving(moving))]
    cut = [line for line in lines if any(cell["levels"] for cell in line.cells.get("ours", []))]
    if cut:
        parts += ["### Ours cut at each level, last frame, first seed, dB", "", table(*_levels(cut))]
    return parts


def _row(line: SceneRow) -> list[str]:
    seeds = max(len(found) for found in line.cells.values())
    return [line.scene, str(line.views), str(seeds), *_figures([line])]


def _mean_row(name: str, lines: Sequence[SceneRow]) -> list[str]:
    """Means over the rows in which every system of the table was measured alike."""
    return [name, "", "", *_figures([line for line in lines if line.lead is not None])]


def _figures(lines: Sequence[SceneRow]) -> list[str]:
    texts = []
    for system in ("ours", "plain"):
        for figure, digits in (("psnr", 2), ("ssim", 3), ("lpips", 3)):
            texts.append(number(_mean(line.first(system, figure) for line in lines), digits))
    lead = _mean(line.lead for line in lines)
    texts.append("-" if lead is None else f"{lead:+.2f}")
    texts.append(number(_mean(line.first("paper", "psnr") for line in lines)))
    return (
        texts
        + [
            number(_mean(line.first(system, "cpu_seconds") for line in lines), 1)
            for system in ("ours", "plain", "paper")
        ]
        + [number(_mean(_kilobytes(line, system) for line in lines), 0) for system in ("ours", "plain")]
    )


def _kilobytes(line: SceneRow, system: str) -> float | None:
    """Size of the first frame, as a packet or a file."""
    size_bytes = line.first(system, "bytes")
    return None if size_bytes is None else size_bytes / 1000


def _places(lines: Sequence[SceneRow]) -> tuple[list[str], list[list[str]]]:
    """At the cameras that trained, and beside them where that is known."""
    systems = ("ours", "plain")
    head = ["scene", "views", *(f"{system} {heading}" for heading in PLACE_HEADINGS for system in systems)]
    rows = []
    for line in lines:
        texts = [number(line.place(system, *place)) for place in PLACES.values() for system in systems]
        rows.append([line.scene, str(line.views), *texts])
    return head, rows


def _moving(lines: Sequence[SceneRow]) -> tuple[list[str], list[list[str]]]:
    head = ["scene", "views"]
    for system in ("ours", "plain"):
        head += [f"{system} first dB", f"{system} last dB", f"{system} moving, first", f"{system} moving, last"]
    rows = []
    for line in lines:
        row = [line.scene, str(line.views)]
        for system in ("ours", "plain"):
            for figure in ("psnr", "moving_psnr"):
                row += [number(line.first(system, figure)), number(line.later(system, figure))]
        rows.append(row)
    return head, rows


def _levels(lines: Sequence[SceneRow]) -> tuple[list[str], list[list[str]]]:
    most = max(len(line.cells["ours"][0]["levels"]) for line in lines)
    head = ["scene", "views", *(str(count + 1) for count in range(most)), "finest gains"]
    rows = []
    for line in lines:
        levels = line.cells["ours"][0]["levels"]
        texts = [number(value) for value in levels] + ["-"] * (most - len(levels))
        gain = f"{levels[-1] - levels[-2]:+.2f}" if len(levels) > 1 else "-"
        rows.append([line.scene, str(line.views), *texts, gain])
    return head, rows


def _lines(found: Sequence[tuple[CellKey, dict[str, Any]]]) -> list[SceneRow]:
    grouped: dict[tuple[str, int], dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for key, figures in found:
        grouped[key.scene, key.views][key.system].append(figures)
    lines = [SceneRow(scene, views, dict(systems)) for (scene, views), systems in grouped.items()]
    return sorted(lines, key=lambda line: (_ORDER[line.scene], line.views))


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
