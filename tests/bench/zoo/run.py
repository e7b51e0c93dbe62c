"""The zoo's protocol: every scene, number of views, seed and contender, one cell each, and a report of the cells."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from streamlod.client.evaluation.measure.footage import footage_of
from streamlod.client.evaluation.measure.scores import Perception, load_perception
from streamlod.client.evaluation.report.output import result_folder
from streamlod.client.recorder import write_png
from streamlod.core.data import Dataset, linspace_split
from streamlod.core.errors import InputError
from streamlod.core.files import write_text
from streamlod.core.initialise import METHODS
from tests.bench.zoo.cells import CellKey, Cells, program_digest
from tests.bench.zoo.contenders import Contest, Measured
from tests.bench.zoo.scenes import SCENES, ZooScene, view_counts
from tests.bench.zoo.tables import zoo_report

_log = logging.getLogger(__name__)
SYSTEMS = ("ours", "plain", "paper")
_MIN_DOWNSCALE = 0.25


@dataclass(frozen=True, slots=True)
class ZooOptions:
    """The cells to measure.

    Attributes:
        scenes: by name. views: numbers of training cameras. seeds: 0, 1, ... so many.
        systems: of `SYSTEMS`; plain needs ours, whose CPU time it gets.
        preset: of ours. downscale: of the pictures, from nominal; below 1 for larger ones, recordings at most as they
            were filmed. frames: the first and later ones, where there is
            video.
        points: the way to first points, of `core.initialise.METHODS`, for all systems.
    """

    scenes: tuple[str, ...] = tuple(scene.name for scene in SCENES)
    views: tuple[int, ...] = (3, 4, 6, 12)
    seeds: int = 2
    systems: tuple[str, ...] = SYSTEMS
    preset: str = "balanced"
    downscale: float = 1.0
    frames: int = 6
    points: str = "auto"

    def __post_init__(self) -> None:
        known = tuple(scene.name for scene in SCENES)
        for what, wanted, allowed in (
            ("scenes", self.scenes, known),
            ("systems", self.systems, SYSTEMS),
            ("points", (self.points,), METHODS),
        ):
            unknown = sorted(set(wanted) - set(allowed))
            if unknown:
                raise InputError(f"--{what}", f"{', '.join(unknown)}: unknown; choose of {', '.join(allowed)}")
        if min(self.views, default=0) < 2 or self.seeds < 1 or self.frames < 1 or self.downscale < _MIN_DOWNSCALE:
            least = f"two views, one seed, one frame, and a downscale of {_MIN_DOWNSCALE:g}"
            raise InputError("zoo", f"needs at least {least}, which is 1920x1080 for synthetic scenes")


def run_zoo(root: Path | None, out: Path, options: ZooOptions) -> str:
    """Measure what is missing into `out` (cells.jsonl, zoo.md, pictures); returns the report.

    The report is renewed after every cell, so that a run that is stopped leaves what it has measured.

    Args:
        root: the folder of the recordings, None for the synthetic scenes alone.

    Raises:
        InputError: `out` holds something else, or a recording cannot be used.
    """
    out = result_folder(out)
    pictures = result_folder(out / "pictures")
    cells, perception = Cells(out / "cells.jsonl", program_digest()), load_perception()
    missing = []
    for scene in (scene for scene in SCENES if scene.name in options.scenes):
        whole = scene.open(root, options.downscale)
        if whole is None:
            missing.append(scene.name)
            _log.warning("%s is skipped: it is not under the data root", scene.name)
            continue
        for key, measured in _measured(scene, whole, options, cells, perception):
            cells.add(key, measured.figures)
            write_png(pictures / picture_name(key, key.system), measured.drawn)
            write_png(pictures / picture_name(key, "truth"), measured.truth)
            _compose(pictures, key)
            first = measured.figures["frames"][0]
            _log.info("%s, %d views, %s: %.2f dB", key.scene, key.views, key.system, first["psnr"])
            write_text(out / "zoo.md", zoo_report(cells, missing))
    report = zoo_report(cells, missing)
    write_text(out / "zoo.md", report)
    return report


def _measured(
    scene: ZooScene, whole: Dataset, options: ZooOptions, cells: Cells, perception: Perception
) -> Iterator[tuple[CellKey, Measured]]:
    """The cells of a scene that are not known yet, ours first, since plain gets its CPU time."""
    frames = min(options.frames, whole.frame_count)
    for views in view_counts(options.views, whole.names):
        keys = [
            CellKey(scene.name, views, seed, system, options.preset, options.downscale, frames, options.points)
            for seed in range(options.seeds)
            for system in SYSTEMS
            if system in options.systems
        ]
        if all(key in cells for key in keys):
            continue
        split = linspace_split(whole.names, views, (scene.held_out,))
        footage = footage_of(whole, split, frames=frames, points=options.points)
        contest = Contest(footage, perception, scene.spec(options.downscale))
        for key in (key for key in keys if key not in cells):
            if key.system == "plain":
                ours = cells.get(replace(key, system="ours"))
                if ours is None:
                    raise InputError("--systems", "plain gets the CPU time of ours: measure ours as well")
                yield key, contest.plain([frame["cpu_seconds"] for frame in ours["frames"]], key.seed)
            else:
                yield key, contest.ours(options.preset if key.system == "ours" else "paper", key.seed)


def picture_name(key: CellKey, shown: str) -> str:
    """Name of a cell's picture; `shown` is ``truth`` or a system."""
    return f"{key.scene}_{key.views}_{key.preset}_{key.seed}_{shown}.png"


def _compose(pictures: Path, key: CellKey) -> None:
    """Truth, ours and plain side by side, where all three have been drawn."""
    paths = [pictures / picture_name(key, shown) for shown in ("truth", "ours", "plain")]
    if all(path.is_file() for path in paths):
        parts: list[Any] = [cv2.imread(str(path)) for path in paths]
        write_png(pictures / picture_name(key, "all"), np.concatenate(parts, axis=1)[..., ::-1])
