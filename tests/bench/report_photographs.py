"""The section of docs/results.md on photographs: few views far apart, beside plain 3D Gaussians of equal CPU time.

Rendered scenes do not show what happens there: their cameras share nearly everything (docs/history/log.md, photographs
between their cameras).
"""

from __future__ import annotations

from collections.abc import Iterable
from statistics import fmean
from typing import Any

from streamlod.client.evaluation.report.tables import number, table
from tests.bench.zoo.cells import CellKey, Cells
from tests.bench.zoo.run import ZooOptions

VIEWS = (3, 6)
_SYSTEMS = ("ours", "plain")
_HEAD = (
    "scene", "views", "PSNR", "SSIM", "at its cameras", "keyframe KB", "plain PSNR", "SSIM", "at its cameras",
    "CPU s of each",
)  # fmt: skip


def photograph_options(scenes: Iterable[str], seeds: int, downscale: float) -> ZooOptions:
    """The zoo's options of this section: first frames of the preset `live`."""
    return ZooOptions(tuple(scenes), VIEWS, seeds, _SYSTEMS, "live", downscale, frames=1)


def photographs(cells: Cells, scenes: Iterable[str], seeds: int) -> str:
    """The section, or nothing where none of `scenes` was measured."""
    rows = []
    for scene in scenes:
        for views in VIEWS:
            ours, plain = (
                [figures for key, figures in cells.items() if _is_of(key, scene, views, seeds, system)]
                for system in _SYSTEMS
            )
            if ours and plain:
                rows.append([scene, str(views), *_shown(ours), _kilobytes(ours), *_shown(plain), _seconds(ours)])
    if not rows:
        return ""
    return f"""## Photographs

First frames of `live`, means of {seeds} seeds, held out and at the cameras that trained (at their best exposure),
beside plain 3D Gaussians from the same first points and for the same CPU seconds.

{table(_HEAD, rows)}
"""


def _is_of(key: CellKey, scene: str, views: int, seeds: int, system: str) -> bool:
    return (key.scene, key.views, key.system, key.frames) == (scene, views, system, 1) and key.seed < seeds


def _shown(cells: list[dict[str, Any]]) -> list[str]:
    first = [cell["frames"][0] for cell in cells]
    at = [place["psnr_fitted"] for cell in cells for place in cell["places"]["at"].values()]
    return [
        number(fmean(frame["psnr"] for frame in first), 1),
        number(fmean(frame["ssim"] for frame in first), 3),
        number(fmean(at) if at else None, 1),
    ]


def _kilobytes(cells: list[dict[str, Any]]) -> str:
    return number(fmean(cell["frames"][0]["bytes"] for cell in cells), 0, 1000)


def _seconds(cells: list[dict[str, Any]]) -> str:
    return number(fmean(cell["frames"][0]["cpu_seconds"] for cell in cells), 0)
