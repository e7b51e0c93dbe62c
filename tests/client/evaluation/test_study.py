"""The report of a whole study, and of a sweep, on a tiny clip."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from streamlod.client.evaluation.design import one_at_a_time
from streamlod.client.evaluation.measure.footage import chosen_split, pictures_digest
from streamlod.client.evaluation.options import StudyOptions, TradeoffOptions
from streamlod.client.evaluation.resume import earlier_report
from streamlod.client.evaluation.rows import Row, study_rows
from streamlod.client.evaluation.study import run_study
from streamlod.client.evaluation.summary import FIGURES
from streamlod.client.evaluation.tradeoff import COSTS, beaten_by, run_tradeoff
from streamlod.core.data.pictures import read_picture
from streamlod.core.errors import InputError
from streamlod.core.synthetic import write_clip
from tests.client.evaluation.conftest import SPEC, shortened


@pytest.mark.long
def test_a_study_writes_figures_tables_and_pictures(clip: Path, tmp_path: Path) -> None:
    (ours, *_) = study_rows("balanced", [])
    rows = [replace(ours, config=shortened(ours.config))]
    options = StudyOptions(views=(2, 3), frames=2, seeds=2, device="cpu")
    text = run_study(clip, tmp_path / "out", options, tuple(rows))
    assert "study.md" in text
    value = json.loads((tmp_path / "out" / "study.json").read_text())
    assert [split["name"] for split in value["splits"]] == [
        "linspace 2 of 3 without cam00",
        "linspace 3 of 3 without cam00",
    ]
    for split in value["splits"]:
        assert [row["name"] for row in split["rows"]] == [row.name for row in rows]
        assert not set(split["train"]) & set(split["test"])
        assert len(split["plots"]) == 5
        for plot in split["plots"]:
            ElementTree.fromstring((tmp_path / "out" / plot).read_text())
        for row in split["rows"]:
            assert [run["seed"] for run in row["seeds"]] == [0, 1]
            assert set(row["summary"]) == set(FIGURES)
            assert {"psnr", "bytes", "shannon_bytes", "seconds"} < set(row["seeds"][0]["per_frame"][0])
            assert row["summary"]["psnr"]["spread"] > 0
            assert read_picture(tmp_path / "out" / row["picture"]).shape == (SPEC.height, 3 * SPEC.width, 3)
    report = (tmp_path / "out" / "study.md").read_text()
    for word in ("linspace 2 of 3", "ours", "±", "Differences from ours"):
        assert word in report
    widths = {line.count("|") for line in report.splitlines() if line.startswith("| ours |")}
    assert len(widths) > 1
    assert not list((tmp_path / "out").glob(".*"))


@pytest.mark.long
def test_a_study_goes_on_where_it_stopped(clip: Path, tmp_path: Path) -> None:
    """What was measured stays as it is, times and all; another system is measured."""
    split = tmp_path / "split.json"
    split.write_text('{"train": ["cam01", "cam03"], "test": ["cam02"]}')
    (ours, *_) = study_rows("balanced", [])
    row = replace(ours, config=shortened(ours.config))
    out = tmp_path / "out"

    def measure(row: Row, seeds: int) -> list[dict[str, Any]]:
        options = StudyOptions(split=split, frames=1, seeds=seeds, device="cpu")
        run_study(clip, out, options, (row,))
        (entry,) = json.loads((out / "study.json").read_text())["splits"]
        assert (entry["name"], entry["train"], entry["test"]) == ("split.json", ["cam01", "cam03"], ["cam02"])
        runs: list[dict[str, Any]] = entry["rows"][0]["seeds"]
        return runs

    (first,) = measure(row, 1)
    both = measure(row, 2)
    assert both[0] == first
    assert both[1]["psnr"] != first["psnr"]
    shorter = replace(row.config, keyframe=replace(row.config.keyframe, steps=10))
    assert measure(replace(row, config=shorter), 1)[0]["psnr"] != first["psnr"]


@pytest.mark.long
def test_what_a_study_measured_stays_in_its_report(clip: Path, tmp_path: Path) -> None:
    """Other systems, other splits and further seeds stay when a later study in the same folder names fewer."""
    ours, paper, *_ = (replace(row, config=shortened(row.config)) for row in study_rows("balanced", []))
    out = tmp_path / "out"

    def measure(rows: tuple[Row, ...], views: int, seeds: int = 1) -> dict[str, Any]:
        run_study(clip, out, StudyOptions(views=(views,), frames=1, seeds=seeds, device="cpu"), rows)
        return json.loads((out / "study.json").read_text())

    before = measure((ours, paper), 2, seeds=2)
    after = measure((ours,), 3)
    assert after["splits"][0] == before["splits"][0]
    assert after["seeds"] == [0, 1]
    assert measure((ours,), 2) == after
    named = {
        name for split in after["splits"] for name in (*split["plots"], *(row["picture"] for row in split["rows"]))
    }
    assert {path.name for path in out.iterdir()} == {*named, "study.json", "study.md"}
    with pytest.raises(InputError, match="differ in preset"):
        run_study(clip, out, StudyOptions(views=(2,), frames=1, preset="live", device="cpu"), (ours,))


def test_a_report_knows_its_data_by_their_pictures_and_cameras(tmp_path: Path) -> None:
    places = [tmp_path / part / "clip" for part in ("a", "b", "c")]
    for place, spec in zip(places, (SPEC, replace(SPEC, kind="night"), SPEC), strict=True):
        write_clip(replace(spec, frames=1), place)
    first, other, same = map(pictures_digest, places)
    assert first == same != other


def test_a_split_file_must_hold_out_cameras_that_exist(clip: Path, tmp_path: Path) -> None:
    split = tmp_path / "split.json"
    for text, fault in (
        ('{"train": ["cam01"]}', "'test' must name at least one held-out camera"),
        ('{"train": ["cam01"], "test": ["cam01"]}', "both train and test"),
        ('{"train": ["cam77"], "test": ["cam00"]}', "there is no camera cam77"),
    ):
        split.write_text(text)
        with pytest.raises(InputError, match=fault):
            chosen_split(clip, split, None, (), 1.0)
    assert chosen_split(clip, None, 2, (), 1.0).test == ("cam00",)


def test_files_that_were_measured_otherwise_or_are_no_reports_are_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    assert earlier_report(path, {}) == {}
    path.write_text("my notes")
    with pytest.raises(InputError, match="is not a report"):
        earlier_report(path, {})
    path.write_text('{"schema": 2, "data": "room", "protocol": {"frames": 4, "downscale": 2}}')
    assert earlier_report(path, {"data": "room"})["schema"] == 2
    with pytest.raises(InputError, match=r"measurements that differ in data and frames; name another folder by --out"):
        earlier_report(path, {"data": "kitchen", "protocol": {"frames": 3, "downscale": 2}, "schema": 2})
    path.write_text("[]")
    with pytest.raises(InputError, match="is not a report"):
        earlier_report(path, {})


@pytest.mark.long
def test_a_sweep_writes_points_fronts_and_plots(clip: Path, tmp_path: Path) -> None:
    names = {"balanced", "downscale 2"}
    points = [replace(point, config=shortened(point.config)) for point in one_at_a_time() if point.name in names]
    options = TradeoffOptions(frames=2, views=2, device="cpu", seeds=2)
    run_tradeoff(clip, tmp_path, replace(options, seeds=1), points)
    single = json.loads((tmp_path / "tradeoff.json").read_text())
    assert all(point["psnr_spread"] == 0 for point in single["points"])
    run_tradeoff(clip, tmp_path, options, points)
    value = json.loads((tmp_path / "tradeoff.json").read_text())
    assert {point["name"] for point in value["points"]} == names
    for point, before in zip(value["points"], single["points"], strict=True):
        assert point["runs"][0] == before["runs"][0]  # not measured again
        first, second = (run["psnr"] for run in point["runs"])
        assert point["psnr"] == pytest.approx((first + second) / 2)
        assert point["psnr_spread"] == pytest.approx(abs(first - second) / 2**0.5)
        assert first != second
    assert set(value["fronts"]) == {cost.key for cost in COSTS}
    best = max(value["points"], key=lambda point: point["psnr"])["name"]
    for cost in COSTS:
        front = value["fronts"][cost.key]
        assert front[-1] == best
        cheapest = min(point[cost.key] for point in value["points"])
        assert cheapest in {point[cost.key] for point in value["points"] if point["name"] == front[0]}
        ElementTree.fromstring((tmp_path / f"{cost.key}.svg").read_text())
    better = {point["name"]: beaten_by(point, value["points"]) for point in value["points"]}
    assert better[best] == []
    assert not any(name in beaten for name, beaten in better.items())
    run_tradeoff(clip, tmp_path, replace(options, seeds=1), points[:1])
    assert json.loads((tmp_path / "tradeoff.json").read_text()) == value  # what was measured stays
    report = (tmp_path / "tradeoff.md").read_text()
    assert all(name in report for name in names)
