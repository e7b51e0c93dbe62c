"""The whole protocol: every system, every split, every seed, one report."""

from __future__ import annotations

import logging
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from core.data import linspace_split, open_dataset
from core.data.synthetic import SyntheticSpec
from core.evaluate.footage import Footage, open_footage
from core.evaluate.machine import machine
from core.evaluate.output import result_folder, side_by_side, write_json, write_png, write_text
from core.evaluate.plots import study_plots
from core.evaluate.quoted import ABLATIONS, SOURCE, TABLES
from core.evaluate.report import study_report
from core.evaluate.rows import LEFT_OUT, Row, study_rows
from core.evaluate.scores import Perception, load_perception
from core.evaluate.sizes import SizeOf
from core.evaluate.summary import run_figures, spread
from core.evaluate.systems import PERCEIVED, FirstFrames, run_system
from core.evaluate.truth import read_spec

_log = logging.getLogger(__name__)
SCHEMA = 1


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """What to measure.

    Attributes:
        views: numbers of training cameras, one split each by the linspace rule.
        frames: at most so many, or None for all.
        seeds: runs of each system, seeded 0, 1, ...
        ablate: which parts to leave out in turn, see `core.evaluate.rows`.
        downscale: of the pictures.
        test: held-out cameras; the first one of the rig where none is named.
        preset: what is called ours.
        device: to train on.
    """

    views: tuple[int, ...] = (3,)
    frames: int | None = 10
    seeds: int = 3
    ablate: tuple[str, ...] = ("all",)
    downscale: float = 1.0
    test: tuple[str, ...] = ()
    preset: str = "balanced"
    device: str = "auto"


def run_study(data: Path, out: Path, options: StudyOptions, size_of: SizeOf, rows: tuple[Row, ...] = ()) -> str:
    """Measure and write `study.json`, `study.md` and pictures into `out`; returns a sentence for people.

    The files are renewed after every system, so that a study that is stopped leaves what it has measured.

    Args:
        rows: systems to compare instead of those that the options name.

    Raises:
        InputError: unusable data, or options that do not fit them.
    """
    systems = rows or study_rows(options.preset, options.ablate)
    names = open_dataset(data, downscale=options.downscale).names
    test = options.test or names[:1]
    splits = [linspace_split(names, views, test) for views in options.views]
    out, spec, perception = result_folder(out), read_spec(data), load_perception()
    study: dict[str, Any] = {
        "schema": SCHEMA,
        "data": data.resolve().name,
        "machine": machine(options.device),
        "protocol": {
            "frames": None,
            "downscale": options.downscale,
            "seeds": list(range(options.seeds)),
            "preset": options.preset,
            "lpips_frames": PERCEIVED,
        },
        "splits": [],
        "left_out": {name: why for name, why in LEFT_OUT.items() if {"all", name} & set(options.ablate)},
        "quoted": {
            "source": SOURCE,
            "tables": {name: [asdict(row) for row in table] for name, table in TABLES.items()},
            "ablations": [asdict(row) for row in ABLATIONS],
        },
    }
    for split in splits:
        footage = open_footage(data, split, frames=options.frames, downscale=options.downscale)
        study["protocol"]["frames"] = footage.frames
        entry: dict[str, Any] = {
            "name": split.name,
            "train": list(split.train),
            "test": list(split.test),
            "points": len(footage.points),
            "rows": [],
            "plots": [],
        }
        study["splits"].append(entry)
        first_frames = FirstFrames(options.device)
        for row in systems:
            runner = _RowRunner(row, footage, first_frames, size_of, perception)
            entry["rows"].append(runner.run(options.seeds, spec, out, len(split.train)))
            _write(out, study)
        for shown, plot in study_plots(split.name, entry["rows"]).items():
            entry["plots"].append(f"{len(split.train)}_{shown}.svg")
            write_text(out / entry["plots"][-1], plot)
        _write(out, study)
    return f"{out / 'study.md'}: {len(systems)} systems, {len(splits)} splits, {options.seeds} seeds"


def _write(out: Path, study: dict[str, Any]) -> None:
    write_json(out / "study.json", study)
    write_text(out / "study.md", study_report(study))


@dataclass(frozen=True, slots=True, eq=False)
class _RowRunner:
    """Measures one system on one split."""

    row: Row
    footage: Footage
    first_frames: FirstFrames
    size_of: SizeOf
    perception: Perception

    def run(self, seeds: int, spec: SyntheticSpec | None, out: Path, views: int) -> dict[str, Any]:
        """The row's entry in the report; its picture (first seed) goes into `out`."""
        runs = []
        picture = f"{views}_{re.sub(r'[^a-z0-9]+', '_', self.row.name.lower())}.png"
        for seed in range(seeds):
            run = run_system(
                replace(self.row.config, seed=seed),
                self.footage,
                self.first_frames,
                self.size_of,
                frozen=self.row.frozen,
                perception=self.perception,
                spec=spec,
            )
            runs.append(run_figures(run))
            if seed == 0:
                write_png(out / picture, side_by_side(run.truth, run.drawn))
            _log.info("%s, %d views, seed %d: %.2f dB", self.row.name, views, seed, runs[-1]["psnr"])
        return {
            "name": self.row.name,
            "note": self.row.note,
            "config": asdict(self.row.config),
            "summary": spread(runs),
            "seeds": runs,
            "picture": picture,
        }
