"""The whole protocol: every system, every split, every seed, one report."""

from __future__ import annotations

import itertools
import logging
import re
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from streamlod.client.evaluation.jobs import in_order
from streamlod.client.evaluation.measure.footage import (
    Footage,
    chosen_split,
    footage_frames,
    open_footage,
    pictures_digest,
)
from streamlod.client.evaluation.measure.machine import machine
from streamlod.client.evaluation.measure.scores import Perception, load_perception
from streamlod.client.evaluation.options import StudyOptions
from streamlod.client.evaluation.report.output import result_folder, side_by_side, write_json
from streamlod.client.evaluation.report.plots import study_plots
from streamlod.client.evaluation.report.report import study_report
from streamlod.client.evaluation.resume import as_json, earlier_report, missing_seeds, with_earlier
from streamlod.client.evaluation.rows import Row, study_rows
from streamlod.client.evaluation.summary import run_figures, spread
from streamlod.client.evaluation.systems import PERCEIVED, FirstFrames, run_system
from streamlod.client.recorder import write_png
from streamlod.core.arrays import UInt8
from streamlod.core.data.names import counted
from streamlod.core.files import write_text
from streamlod.core.synthetic import SyntheticSpec, read_spec

_log = logging.getLogger(__name__)
SCHEMA = 5


def run_study(data: Path, out: Path, options: StudyOptions, rows: tuple[Row, ...] = ()) -> str:
    """Measure and write `study.json`, `study.md` and pictures into `out`; returns a sentence for people.

    The files are renewed after every run, all systems with one seed before the next seed, so that a study that is
    stopped leaves what it has measured. Runs that `out` holds already stay in the report, those of other systems and
    splits too, and are not measured again.

    Args:
        rows: systems to compare instead of those that the options name.

    Raises:
        InputError: unusable data, or options that do not fit them.
    """
    systems = rows or study_rows(options.preset, options.ablate)
    views = (None,) if options.split else options.views
    splits = [chosen_split(data, options.split, number, options.test, options.downscale) for number in views]
    out, spec, perception = result_folder(out), read_spec(data), load_perception()
    study = _begun_study(data, out, options)
    for split in splits:
        footage = open_footage(data, split, frames=options.frames, downscale=options.downscale)
        number = _begun_split(study["splits"], footage)
        runner = _Runner(footage, FirstFrames(options.device), perception, spec, number)
        entry = study["splits"][number]
        wanted = [_row_entry(row, runner.picture(row)) for row in systems]
        begun = with_earlier(wanted, entry["rows"], "seeds", lambda row: [row["config"], row["frozen"]])
        numbers = itertools.product(range(options.seeds), range(len(systems)))
        missing = [(seed, row) for seed, row in numbers if seed in missing_seeds(begun[row], "seeds", options.seeds)]
        runs = [(seed, systems[row]) for seed, row in missing]
        with closing(in_order(runner.run, runs, options.jobs, options.device)) as measured:
            for (seed, row), (figures, shown) in zip(missing, measured, strict=True):
                name = begun[row]["name"]
                if seed == 0:
                    write_png(out / begun[row]["picture"], shown)
                _log.info("%s, %s, seed %d: %.2f dB", split.name, name, seed, figures["psnr"])
                begun[row] = {**begun[row], "seeds": [*begun[row]["seeds"], figures]}
                entry["rows"] = _measured(begun)
                _write(out, study)
        entry["rows"] = _measured(begun)
        plots = study_plots(split.name, entry["rows"])
        entry["plots"] = [f"{number}_{name}.svg" for name in plots]
        for path, plot in zip(entry["plots"], plots.values(), strict=True):
            write_text(out / path, plot)
        _write(out, study)
    names = {row["name"] for entry in study["splits"] for row in entry["rows"]}
    found = ((names, "system"), (study["splits"], "split"), (study["seeds"], "seed"))
    return f"{out / 'study.md'}: {', '.join(counted(len(each), what) for each, what in found)}"


def _begun_study(data: Path, out: Path, options: StudyOptions) -> dict[str, Any]:
    """The report before any new run: what an earlier one of `out` has measured."""
    frames = footage_frames(data, options.frames)
    study: dict[str, Any] = {
        "schema": SCHEMA,
        "data": data.resolve().name,
        "pictures": pictures_digest(data),
        "machine": machine(options.device) | ({} if options.jobs == "local" else {"jobs": options.jobs}),
        "protocol": {"frames": frames, "downscale": options.downscale, "lpips_frames": PERCEIVED},
        "preset": options.preset,
    }
    earlier = earlier_report(out / "study.json", {key: study[key] for key in study if key != "data"})
    seeds = sorted({*range(options.seeds), *earlier.get("seeds", [])})
    return {**study, "seeds": seeds, "splits": earlier.get("splits", [])}


def _begun_split(splits: list[dict[str, Any]], footage: Footage) -> int:
    """Number in `splits` of the entry of a footage's split, which is added where there is none.

    Where the first points are not the earlier ones, the entry begins anew: figures could not be compared.
    """
    split = footage.split
    facts = {"name": split.name, "train": list(split.train), "test": list(split.test), "points": len(footage.points)}
    begun = {**facts, "rows": [], "plots": []}
    for number, entry in enumerate(splits):
        if all(entry[key] == begun[key] for key in ("train", "test")):
            splits[number] = {**entry, **facts} if entry["points"] == begun["points"] else begun
            return number
    splits.append(begun)
    return len(splits) - 1


def _row_entry(row: Row, picture: str) -> dict[str, Any]:
    """A system's entry in the report, before any run."""
    facts = {"name": row.name, "note": row.note, "frozen": row.frozen, "config": as_json(asdict(row.config))}
    return {**facts, "picture": picture, "seeds": []}


def _measured(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The entries that have a run, with the spread of their figures."""
    return [{**row, "summary": spread(row["seeds"])} for row in rows if row["seeds"]]


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
    number: int  # of the split in the report

    def picture(self, row: Row) -> str:
        """Name of the file of a system's picture."""
        return f"{self.number}_{re.sub(r'[^a-z0-9]+', '_', row.name.lower())}.png"

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
