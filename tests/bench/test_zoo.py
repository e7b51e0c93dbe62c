"""The zoo goes on where it stopped, gives plain the time of ours, and reports what it measured."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from streamlod.core.errors import InputError
from streamlod.core.synthetic import SyntheticSpec
from streamlod.core.synthetic.spec import cameras as cameras_of
from streamlod.core.train import preset
from tests.bench.report_bench import Found, page, worst_pictures
from tests.bench.report_photographs import photographs
from tests.bench.zoo.cells import CellKey, Cells, program_digest
from tests.bench.zoo.run import ZooOptions, run_zoo
from tests.bench.zoo.scenes import SCENES, view_counts
from tests.bench.zoo.tables import zoo_report
from tests.client.evaluation.conftest import shortened
from tests.core.data.writers import write_transforms

pytestmark = pytest.mark.timeout(600)  # one row is trained, however busy the machine
QUICK = ZooOptions(("bright",), (3,), 1, ("ours", "plain"), "live", 7.5, 2)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The zoo of one small row, trained in few steps."""
    folder = tmp_path_factory.mktemp("zoo") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.bench.zoo.contenders.preset", lambda name: shortened(preset(name)))
        run_zoo(None, folder, QUICK)
    return folder


def lines(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "cells.jsonl").read_text().splitlines()]


@pytest.mark.long
def test_a_row_is_measured_with_equal_time(out: Path) -> None:
    ours, plain = lines(out)
    assert (ours["key"]["system"], plain["key"]["system"]) == ("ours", "plain")
    assert len(ours["figures"]["frames"]) == len(plain["figures"]["frames"]) == 2
    for mine, theirs in zip(ours["figures"]["frames"], plain["figures"]["frames"], strict=True):
        assert theirs["cpu_seconds"] == pytest.approx(mine["cpu_seconds"], rel=0.2, abs=0.3)
        assert 8 < theirs["psnr"] < 50
        assert 8 < mine["psnr"] < 50
        assert mine["moving_psnr"] is not None
        assert theirs["moving_psnr"] is not None
    assert all(len(cell["figures"]["places"]["at"]) == 3 for cell in (ours, plain))
    assert ours["figures"]["levels"][-1] == pytest.approx(ours["figures"]["frames"][-1]["psnr"], abs=0.01)
    assert all(cell["figures"]["frames"][0]["bytes"] > 1000 for cell in (ours, plain))


@pytest.mark.long
def test_pictures_and_report_lie_beside_the_cells(out: Path) -> None:
    both = cv2.imread(str(out / "pictures" / "bright_3_live_0_all.png"))
    assert both is not None
    assert both.shape == (36, 3 * 64, 3)
    report = (out / "zoo.md").read_text()
    assert "| bright | 3 | 1 |" in report
    assert "mean of the choosing half" in report
    assert "reporting half" not in report


@pytest.mark.long
def test_the_page_of_results_shows_levels_and_the_worst_run(out: Path) -> None:
    options = Namespace(
        scenes=["bright"], presets=["live"], views=3, frames=2, seeds=1, out=out, photographs=["castle"]
    )
    found = Found(options, Cells(out / "cells.jsonl", program_digest()))
    ours = lines(out)[0]["figures"]
    text = page(found)
    assert f"| bright | `live` | {', '.join(f'{value:.1f}' for value in ours['levels'])} |" in text
    assert "bright `live` seed 0." in text
    assert "Photographs" not in text  # none was measured
    assert worst_pictures(found).shape == (36, 3 * 64, 3)


@pytest.mark.long
def test_it_goes_on_where_it_stopped(out: Path) -> None:
    before = (out / "cells.jsonl").read_bytes()
    run_zoo(None, out, QUICK)
    assert (out / "cells.jsonl").read_bytes() == before


def test_recordings_that_are_not_there_are_skipped_and_named(tmp_path: Path) -> None:
    options = ZooOptions(("castle", "stage"), (3,), 1)
    assert "castle, stage" in run_zoo(tmp_path, tmp_path / "out", options)


def test_plain_alone_is_refused(tmp_path: Path) -> None:
    options = ZooOptions(("bright",), (3,), 1, ("plain",), "live", 8.0, 1)
    with pytest.raises(InputError, match="measure ours as well"):
        run_zoo(None, tmp_path, options)


@pytest.mark.parametrize(
    "fields",
    [
        {"scenes": ("cellar",)},
        {"systems": ("theirs",)},
        {"views": (1,)},
        {"seeds": 0},
        {"downscale": 0.2},
        {"points": "guessed"},
    ],
)
def test_options_that_mean_nothing_are_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        ZooOptions(**fields)


def test_the_halves_are_as_agreed() -> None:
    halves = {half: {scene.name for scene in SCENES if scene.half == half} for half in ("choosing", "reporting")}
    assert halves["choosing"] == {"room", "bright", "night", "castle", "flame_steak_frame0"}
    assert halves["reporting"] == {"theatre", "outdoor", "stage", "fountain", "caliscope_4cam"}


def test_no_recording_is_enlarged(tmp_path: Path) -> None:
    (tmp_path / "castle").mkdir()
    cameras = cameras_of(SyntheticSpec(cameras=3, width=64, height=48))
    files = [f"{camera.name}.png" for camera in cameras]
    for file in files:
        cv2.imwrite(str(tmp_path / "castle" / file), np.zeros((48, 64, 3), np.uint8))
    write_transforms(tmp_path / "castle", files, cameras)
    castle = next(scene for scene in SCENES if scene.name == "castle")
    opened = [castle.open(tmp_path, downscale) for downscale in (0.5, 1.0, 2.0)]
    assert [found.cameras[0].width for found in opened if found] == [64, 64, 32]


def test_no_more_views_than_cameras_remain() -> None:
    assert view_counts((3, 4, 6, 12), ("a",) * 9) == (3, 4, 6, 8)
    assert view_counts((3, 4, 6, 12), ("a",) * 4) == (3,)
    assert view_counts((12, 20), ("a",) * 30) == (12,)


def key(system: str, scene: str = "bright", seed: int = 0) -> CellKey:
    return CellKey(scene, 3, seed, system, "live", 2.0, 1, "auto")


def cell(psnr: float, cpu: float = 10.0) -> dict[str, Any]:
    return {
        "frames": [{"psnr": psnr, "ssim": 0.9, "lpips": None, "cpu_seconds": cpu}],
        "levels": [psnr - 2, psnr],
        "places": {"at": {}, "beside": {}},
    }


def test_a_line_that_was_cut_off_is_measured_again(tmp_path: Path) -> None:
    path = tmp_path / "cells.jsonl"
    cells = Cells(path, "now")
    cells.add(key("ours"), cell(30))
    cells.add(key("plain"), cell(29))
    path.write_bytes(path.read_bytes()[:-20])
    cells = Cells(path, "now")
    assert key("ours") in cells
    assert key("plain") not in cells
    cells.add(key("plain"), cell(28))
    assert Cells(path, "now").get(key("plain")) == cell(28)


def test_photographs_stand_beside_plain_gaussians(tmp_path: Path) -> None:
    cells = Cells(tmp_path / "cells.jsonl", "now")
    at = {"at": {"0001": {"psnr_fitted": 36.0}, "0002": {"psnr_fitted": 35.0}}}
    for seed, psnr in ((0, 30.0), (1, 32.0)):
        cells.add(key("ours", "fountain", seed), photographed(psnr) | {"places": at})
        cells.add(key("plain", "fountain", seed), photographed(29.0))
    section = photographs(cells, ["castle", "fountain"], 2)
    assert "| fountain | 3 | 31.0 | 0.900 | 35.5 | 40 | 29.0 | 0.900 | - | 10 |" in section
    assert "castle" not in section
    assert photographs(cells, ["castle"], 2) == ""


def photographed(psnr: float) -> dict[str, Any]:
    found = cell(psnr)
    found["frames"][0]["bytes"] = 40_000
    return found


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cells.jsonl"
    path.write_text("shopping\nlist\n")
    with pytest.raises(InputError, match="line 1"):
        Cells(path, "now")
    path.write_text(json.dumps({"schema": 99, "key": asdict(key("ours")), "figures": {}}) + "\n")
    with pytest.raises(InputError, match="schema"):
        Cells(path, "now")


def test_a_run_goes_on_with_the_program_that_began_it(tmp_path: Path) -> None:
    path = tmp_path / "cells.jsonl"
    Cells(path, "before").add(key("ours"), cell(30))
    with pytest.raises(InputError, match="another program"):
        Cells(path, "now")
    assert key("ours") in Cells(path, "before")


def test_means_are_over_the_rows_that_both_have(tmp_path: Path) -> None:
    cells = Cells(tmp_path / "cells.jsonl", "now")
    for seed, psnr in ((0, 30.0), (1, 32.0)):
        cells.add(key("ours", seed=seed), cell(psnr))
        cells.add(key("plain", seed=seed), cell(29.0))
    cells.add(key("ours", "room"), cell(10.0))
    report = zoo_report(cells)
    assert "| bright | 3 | 2 | 31.00 | 0.900 | - | 29.00 | 0.900 | - | +2.00 |" in report
    assert "| mean of the choosing half |  |  | 31.00 | 0.900 | - | 29.00 | 0.900 | - | +2.00 |" in report
    assert "| bright | 3 | 28.00 | 30.00 | +2.00 |" in report
