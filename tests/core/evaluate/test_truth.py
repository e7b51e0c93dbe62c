"""The dynamic set against true motion, on anchors placed where the truth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.anchors import Scene
from core.arrays import Int64
from core.data.synthetic import is_dynamic
from core.errors import InputError
from core.evaluate.footage import Footage
from core.evaluate.truth import dynamic_precision_recall, read_spec
from core.expand import anchor_positions
from core.residual import Residual, difference
from core.train import TrainConfig, Trainer
from tests.core.evaluate.conftest import SPEC, shortened


@pytest.fixture(scope="module")
def scene(footage: Footage) -> Scene:
    training, _ = next(footage.pairs())
    return (
        Trainer(footage.training.cameras, shortened(TrainConfig()), 30, "cpu").keyframe(training, footage.points).scene
    )


def changing(scene: Scene, rows: list[Int64]) -> Residual:
    """A residual that moves `rows` of each level by one step."""
    levels = []
    for level, chosen in zip(scene.levels, rows, strict=True):
        position = level.position.copy()
        position[chosen] += 1
        levels.append(replace(level, position=position))
    return difference(scene, replace(scene, levels=tuple(levels), version=1))


def moving_rows(scene: Scene) -> list[Int64]:
    """Anchors of each level within half a cell, or 3 cm, of a surface that moves."""
    rows = []
    for number, level in enumerate(scene.levels):
        reach = max(0.03, scene.header.octree.cell(number) / 2)
        rows.append(np.flatnonzero(is_dynamic(SPEC, anchor_positions(scene.header, number, level), 1, tolerance=reach)))
    return rows


def test_the_truth_itself_scores_full_marks(scene: Scene) -> None:
    rows = moving_rows(scene)
    assert sum(map(len, rows)) > 0
    score = dynamic_precision_recall(SPEC, scene, changing(scene, rows), 1)
    assert score.precision == score.recall == 1
    assert score.moving == sum(map(len, rows))


def test_half_found_and_everything_changed(scene: Scene) -> None:
    rows = moving_rows(scene)
    half = dynamic_precision_recall(SPEC, scene, changing(scene, [part[::2] for part in rows]), 1)
    assert half.precision == 1
    drawn = half.moving - half.changed  # of the other half, what is drawn
    assert 0 < drawn <= sum(len(part[1::2]) for part in rows)
    assert half.recall == half.changed / half.moving
    all_rows = [np.arange(len(level)) for level in scene.levels]
    everything = dynamic_precision_recall(SPEC, scene, changing(scene, all_rows), 1)
    assert everything.recall == 1
    assert everything.precision == sum(map(len, rows)) / scene.anchor_count


def test_what_is_not_drawn_need_not_change(scene: Scene) -> None:
    """Anchors that are dead, or transparent, are no misses."""
    buried = replace(scene, levels=tuple(replace(level, alive=~level.alive) for level in scene.levels))
    nothing = [np.zeros(0, np.int64) for _ in scene.levels]
    assert dynamic_precision_recall(SPEC, scene, changing(scene, nothing), 1).recall == 0
    assert dynamic_precision_recall(SPEC, buried, changing(buried, nothing), 1).moving == 0


def test_nothing_moves_in_a_still_clip(scene: Scene) -> None:
    nothing = [np.zeros(0, np.int64) for _ in scene.levels]
    score = dynamic_precision_recall(replace(SPEC, still=True), scene, changing(scene, nothing), 1)
    assert (score.changed, score.moving, score.precision, score.recall) == (0, 0, 1, 1)


def test_the_description_of_a_clip_is_read_back(clip: Path, tmp_path: Path) -> None:
    assert read_spec(clip) == SPEC
    assert read_spec(tmp_path) is None


@pytest.mark.parametrize(
    "text", ["[]", "{}", '{"spec": {"cameras": 3}}', '{"spec": 5}', "{", '{"spec": {"cameras": "many", "rest": 0}}']
)
def test_a_damaged_description_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "ground_truth").mkdir()
    (tmp_path / "ground_truth" / "spec.json").write_text(text)
    with pytest.raises(InputError):
        read_spec(tmp_path)


def test_a_description_with_a_value_of_another_type_is_refused(clip: Path, tmp_path: Path) -> None:
    value = json.loads((clip / "ground_truth" / "spec.json").read_text())
    value["spec"]["frames"] = "10"
    (tmp_path / "ground_truth").mkdir()
    (tmp_path / "ground_truth" / "spec.json").write_text(json.dumps(value))
    with pytest.raises(InputError):
        read_spec(tmp_path)
