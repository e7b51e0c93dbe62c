"""The systems of a study differ from ours in what their names say, and in nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from streamlod.client.evaluation.design import one_at_a_time
from streamlod.client.evaluation.rows import ABLATIONS, study_rows, unquantised
from streamlod.core.errors import InputError
from streamlod.core.train import preset


def test_every_ablation_changes_something_and_names_are_unique() -> None:
    rows = study_rows("balanced", ["all"])
    assert len({row.name for row in rows}) == len(rows)
    ours = rows[0].config
    assert ours == preset("balanced")
    assert all(row.config != ours for row in rows[1:] if not row.frozen)
    assert {"ours", "paper", "paper star", "frozen", "full"} < {row.name for row in rows}


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_one_ablation_adds_its_rows_only(ablation: str) -> None:
    bare, with_it = study_rows("balanced", []), study_rows("balanced", [ablation])
    added = [row for row in with_it if row not in bare]
    assert added
    assert set(bare) < set(with_it)
    later_frames_only = [row for row in added if row.config.model == bare[0].config.model]
    assert bool(set(added) - set(later_frames_only)) == (ablation == "lod")


def test_what_is_unknown_is_refused() -> None:
    with pytest.raises(InputError, match="nonsense"):
        study_rows("balanced", ["nonsense"])
    with pytest.raises(InputError, match="preset"):
        study_rows("nonsense", ["all"])


def test_unquantised_moves_parameters_as_before() -> None:
    config = preset("balanced")
    fine = unquantised(config).predict
    assert fine.latent_rate * fine.feature_step == pytest.approx(
        config.predict.latent_rate * config.predict.feature_step
    )
    assert fine.position_rate == config.predict.position_rate  # in pixels, whatever the steps


def test_each_point_of_the_design_turns_one_knob() -> None:
    points, base = one_at_a_time(), preset("balanced")
    assert len({point.name for point in points}) == len(points)
    for point in points:
        if point.knob == "preset":
            continue
        config = point.config
        parts = [config.model != base.model, config.keyframe != base.keyframe, config.predict != base.predict]
        assert sum(parts) + (point.shrink != 1) == 1, point.name
        assert replace(config, model=base.model, keyframe=base.keyframe, predict=base.predict, parts=base.parts) == base
