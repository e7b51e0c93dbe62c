"""The page docs/results.md: what streamlod achieves, measured now, with date, commit and machine.

    streamlod bench report --out FOLDER [--scenes theatre outdoor] [--presets live balanced quality] [--seeds 2]
        [--views 5] [--frames 8] [--photographs fountain] [--data DATA] [--page docs/results.md]

Scenes are those of the zoo's reporting half, on which nothing was chosen. Photographs are looked for under --data or
STREAMLOD_DATA. Goes on where it was stopped: what FOLDER holds of the same program is not measured again.
"""

from __future__ import annotations

import argparse
import logging
import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import fmean
from typing import Any

import cv2
import numpy as np

from streamlod.client.evaluation.measure.machine import machine
from streamlod.client.evaluation.report.output import result_folder, side_by_side
from streamlod.client.evaluation.report.tables import number, table
from streamlod.core.arrays import UInt8
from streamlod.core.files import write_text
from streamlod.core.options import PRESETS
from tests.bench.report_photographs import photograph_options, photographs
from tests.bench.zoo.cells import CellKey, Cells, program_digest
from tests.bench.zoo.run import ZooOptions, picture_name, run_zoo

DOWNSCALE = 2.0  # of pictures of 480x270
PICTURE = "results-worst.jpg"  # in images, beside the page
ROOT = Path(__file__).parents[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the measurements")
    parser.add_argument("--scenes", nargs="+", default=["theatre", "outdoor"])
    parser.add_argument("--presets", nargs="+", default=list(PRESETS))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--photographs", nargs="*", default=["fountain"], help="first frames alone")
    parser.add_argument("--data", type=Path, default=os.environ.get("STREAMLOD_DATA"), help="folder of recordings")
    parser.add_argument("--page", type=Path, help="also write the page here")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    for preset in options.presets:
        run_zoo(options.data, options.out, zoo(options, preset))
    if options.photographs:
        run_zoo(options.data, options.out, photograph_options(options.photographs, options.seeds, DOWNSCALE))
    found = Found(options, Cells(options.out / "cells.jsonl", program_digest()))
    text = page(found)
    if options.page:
        write_text(options.page, text)
        picture = result_folder(options.page.parent / "images") / PICTURE
        cv2.imwrite(str(picture), worst_pictures(found)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    print(text)


def zoo(options: argparse.Namespace, preset: str) -> ZooOptions:
    """The zoo's options of one preset."""
    return ZooOptions(
        tuple(options.scenes), (options.views,), options.seeds, ("ours",), preset, DOWNSCALE, options.frames
    )


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What was asked for, and the cells of its folder."""

    options: argparse.Namespace
    cells: Cells

    def of(self, scene: str, preset: str) -> dict[CellKey, dict[str, Any]]:
        """Cells of a scene and a preset, a seed each."""
        wanted = (scene, preset, self.options.views, self.options.frames)
        return {
            key: figures
            for key, figures in self.cells.items()
            if (key.scene, key.preset, key.views, key.frames) == wanted and key.seed < self.options.seeds
        }

    def worst(self, scene: str) -> CellKey:
        """The cell of a scene whose last frame is farthest from the truth."""
        cells = {key: figures for preset in self.options.presets for key, figures in self.of(scene, preset).items()}
        return min(cells, key=lambda key: cells[key]["frames"][-1]["psnr"])


def page(found: Found) -> str:
    """The page, from the cells that its options name."""
    options = found.options
    pairs = [(scene, preset) for scene in options.scenes for preset in options.presets]
    cells = {pair: list(found.of(*pair).values()) for pair in pairs}
    rows = [[scene, f"`{preset}`", *summary(cells[scene, preset])] for scene, preset in pairs]
    levels = [[scene, f"`{preset}`", level_text(cells[scene, preset])] for scene, preset in pairs]
    head = (
        "scene", "preset", "PSNR", "SSIM", "moving PSNR", "KB a frame", "keyframe KB", "CPU s a frame",
        "first frame, CPU s", "anchors",
    )  # fmt: skip
    where = machine("cpu")
    return f"""# Results

Printed by `{command()}`
on {datetime.now(UTC):%d %B %Y}, commit {commit()}, {where["processor"]}, {where["cores"]} cores,
Python {where["python"]}, torch {where["torch"]}. CPU seconds are of one thread, beside whatever else ran.

Held-out camera, {options.views} of 12 training views, pictures of 240x135, means of {options.frames} frames and \
{options.seeds} seeds. Scenes are of
the reporting half of the zoo, on which nothing was chosen. Older figures, with their commands, are in
[history](history/README.md).

{table(head, rows)}
{photographs(found.cells, options.photographs, options.seeds)}## Levels

PSNR of the first seed's last frame for a viewer who has its coarsest level alone, that and the next, and so on to the
whole.

{table(("scene", "preset", "PSNR up to each level"), levels)}
## The worst, looked at

The last frame of each scene's worst run: truth, what was drawn, and the difference times four. Edges are what is
missing, and thin things that few of the cameras see. From above:
{worst_names(found)}.

![truth, drawn and difference of each scene](images/{PICTURE})
"""


def level_text(cells: list[dict[str, Any]]) -> str:
    """PSNR up to each level, coarsest first, of the first seed."""
    return ", ".join(number(value, 1) for value in cells[0]["levels"]) if cells else "-"


def worst_names(found: Found) -> str:
    """Scene, preset and seed of each picture."""
    keys = [found.worst(scene) for scene in found.options.scenes]
    return ", ".join(f"{key.scene} `{key.preset}` seed {key.seed}" for key in keys)


def worst_pictures(found: Found) -> UInt8:
    """[H,W,3] truth, drawing and difference of the worst run of each scene, one below the other."""
    rows = []
    for key in (found.worst(scene) for scene in found.options.scenes):
        names = [found.options.out / "pictures" / picture_name(key, shown) for shown in ("truth", key.system)]
        truth, drawn = (np.asarray(cv2.imread(str(name)), np.uint8)[..., ::-1] for name in names)
        rows.append(side_by_side(truth, drawn))
    return np.concatenate(rows)


def summary(cells: list[dict[str, Any]]) -> list[str]:
    """Figures of one row: means over seeds, and over frames; bytes and seconds of later frames by themselves."""
    later = [frame for cell in cells for frame in cell["frames"][1:]]
    frames = [frame for cell in cells for frame in cell["frames"]]
    first = [cell["frames"][0] for cell in cells]
    return [
        number(mean(frames, "psnr"), 1),
        number(mean(frames, "ssim"), 3),
        number(mean(later, "moving_psnr"), 1),
        number(mean(later, "bytes"), 1, 1000),
        number(mean(first, "bytes"), 0, 1000),
        number(mean(later, "cpu_seconds"), 2),
        number(mean(first, "cpu_seconds"), 0),
        number(mean(cells, "parts"), 0),
    ]


def mean(frames: Iterable[dict[str, Any]], name: str) -> float | None:
    """Mean of a figure where it was measured."""
    found = [frame[name] for frame in frames if frame.get(name) is not None]
    return fmean(found) if found else None


def command() -> str:
    """The command that runs, without its folders."""
    given = sys.argv[1:]
    folders = [index for index, word in enumerate(given) if word in {"--out", "--page", "--data"}]
    hidden = {index + step for index in folders for step in (0, 1)}
    words = [word for index, word in enumerate(given) if index not in hidden]
    return " ".join(["streamlod bench report --out FOLDER", *words])


def commit() -> str:
    """The checkout's commit, and whether it is that."""
    asked = ["git", "describe", "--always", "--dirty", "--abbrev=10"]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    main()
