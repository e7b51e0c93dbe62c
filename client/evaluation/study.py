"""The whole protocol: every system, every split, every seed, one report."""

from __future__ import annotations

import itertools
import json
import logging
import re
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from streamlod.client.evaluation.jobs import in_order
from streamlod.client.evaluation.measure.footage import Footage, chosen_split, open_footage
from streamlod.client.evaluation.measure.machine import machine
from streamlod.client.evaluation.measure.scores import Perception, load_perception
from streamlod.client.evaluation.options import StudyOptions
from streamlod.client.evaluation.report.output import result_folder, side_by_side, write_json
from streamlod.client.evaluation.report.plots import study_plots
from streamlod.client.evaluation.report.report import study_report
from streamlod.client.evaluation.resume import earlier_report
from streamlod.client.evaluation.rows import Row, study_rows
from streamlod.client.evaluation.summary import run_figures, spread
from streamlod.client.evaluation.systems import PERCEIVED, FirstFrames, run_system
from streamlod.client.recorder import write_png
from streamlod.core.arrays import UInt8
from streamlod.core.files import write_text
from streamlod.core.synthetic import SyntheticSpec, read_spec

_log = logging.getLogger(__name__)
SCHEMA = 4
_FACTS = ("data", "machine", "protocol")  # under which runs may stand in one report


def run_study(data: Path, out: Path, options: StudyOptions, rows: tuple[Row, ...] = ()) -> str:
    """Measure and write `study.json`, `study.md` and pictures into `out`; returns a sentence for people.

    The files are renewed after every run, all systems with one seed before the next seed, so that a study that is
    stopped leaves what it has measured. Runs that `out` holds already are not measured again.

    Args:
        rows: systems to compare instead of those that the options name.

    Raises:
        InputError: unusable data, or options that do not fit them.
    """
    systems = rows or study_rows(options.preset, options.ablate)
    views = (None,) if options.split else options.views
    splits = [chosen_split(data, options.split, number, options.test, options.downscale) for number in views]
    out, spec, perception = result_folder(out), read_spec(data), load_perception()
    footages = (open_footage(data, split, frames=options.frames, downscale=options.downscale) for split in splits)
    study = _empty_study(data, options)
    earlier: dict[str, Any] = {}
    for footage in footages:
        study["protocol"]["frames"] = footage.frames
        earlier = earlier or earlier_report(out / "study.json", {key: study[key] for key in ("schema", *_FACTS)})
        split = footage.split
        entry: dict[str, Any] = {
            "name": split.name,
            "train": list(split.train),
            "test": list(split.test),
            "points": len(footage.points),
            "rows": [],
            "plots": [],
        }
        study["splits"].append(entry)
        runner = _Runner(footage, FirstFrames(options.device), perception, spec)
        known = _known_runs(earlier, entry)
        runs: dict[str, list[dict[str, Any]]] = {row.name: [] for row in systems}
        wanted = list(itertools.product(range(options.seeds), systems))
        found = [known.get((_identity(_row_entry(row, [], "")), seed)) for seed, row in wanted]
        missing = [run for run, figures in zip(wanted, found, strict=True) if figures is None]
        with closing(in_order(runner.run, missing, options.jobs, options.device)) as measured:
            for (seed, row), known_figures in zip(wanted, found, strict=True):
                figures = known_figures
                if figures is None:
                    figures, shown = next(measured)
                    if seed == 0:
                        write_png(out / runner.picture(row), shown)
                    _log.info("%s, %s, seed %d: %.2f dB", split.name, row.name, seed, figures["psnr"])
                runs[row.name].append(figures)
                done = [row for row in systems if runs[row.name]]
                entry["rows"] = [_row_entry(row, runs[row.name], runner.picture(row)) for row in done]
                _write(out, study)
        for name, plot in study_plots(split.name, entry["rows"]).items():
            entry["plots"].append(f"{len(split.train)}_{name}.svg")
            write_text(out / entry["plots"][-1], plot)
        _write(out, study)
    return f"{out / 'study.md'}: {len(systems)} systems, {len(splits)} splits, {options.seeds} seeds"


def _empty_study(data: Path, options: StudyOptions) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "data": data.resolve().name,
        "machine": machine(options.device) | ({} if options.jobs == "local" else {"jobs": options.jobs}),
        "protocol": {"frames": None, "downscale": options.downscale, "lpips_frames": PERCEIVED},
        "seeds": list(range(options.seeds)),
        "preset": options.preset,
        "splits": [],
    }


def _known_runs(earlier: dict[str, Any], split: dict[str, Any]) -> dict[tuple[str, int], dict[str, Any]]:
    """Runs of an earlier report on the same split, by what identifies the system, and seed."""
    same = [
        other
        for other in earlier.get("splits", [])
        if all(other[key] == split[key] for key in ("train", "test", "points"))
    ]
    rows = [row for other in same for row in other["rows"]]
    return {(_identity(row), run["seed"]): run for row in rows for run in row["seeds"]}


def _identity(row: dict[str, Any]) -> str:
    return json.dumps([row["config"], row["frozen"]], sort_keys=True)


def _row_entry(row: Row, runs: list[dict[str, Any]], picture: str) -> dict[str, Any]:
    """A system's entry in the report."""
    return {
        "name": row.name,
        "note": row.note,
        "frozen": row.frozen,
        "config": asdict(row.config),
        "summary": spread(runs),
        "seeds": runs,
        "picture": picture,
    }


def _write(out: Path, study: dict[str, Any]) -> None:
    write_json(out / "study.json", study)
    write_text(out / "study.md", study_report(study))


@dataclass(frozen=True, slots=True, eq=False)
class _Runner:
    """Measures systems on one split."""

    footage: Footage
    first_frames: FirstFrames
    perception: Perception
    spec: SyntheticSpec | None

    def picture(self, row: Row) -> str:
        """Name of the file of a system's picture."""
        return f"{len(self.footage.split.train)}_{re.sub(r'[^a-z0-9]+', '_', row.name.lower())}.png"

    def run(self, seed: int, row: Row) -> tuple[dict[str, Any], UInt8]:
        """Figures of one run, and its picture beside the truth."""
        run = run_system(
            replace(row.config, seed=seed),
            self.footage,
            self.first_frames,
            frozen=row.frozen,
            perception=self.perception,
            spec=self.spec,
        )
        return run_figures(run), side_by_side(run.truth, run.drawn)
