"""The preset `paper` is spelled out: every setting has a source, and the documented table is the one in force."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from core.train import KeyframeConfig, ModelConfig, PredictConfig, preset
from core.train.paper import KEYFRAME, MODEL, PREDICT, Choice, paper_table

DOCUMENT = Path(__file__).parents[3] / "docs" / "preset-paper.md"
TABLES = [(ModelConfig, MODEL), (KeyframeConfig, KEYFRAME), (PredictConfig, PREDICT)]


@pytest.mark.parametrize(("config", "table"), TABLES, ids=lambda value: getattr(value, "__name__", ""))
def test_every_setting_is_given_and_has_a_source(config: type, table: dict[str, Choice]) -> None:
    assert set(table) == {field.name for field in fields(config)}
    assert all(choice.why for choice in table.values())


def test_the_preset_holds_the_values_of_the_tables() -> None:
    config = preset("paper")
    for part, (_, table) in zip((config.model, config.keyframe, config.predict), TABLES, strict=True):
        assert {name: getattr(part, name) for name in table} == {name: row.value for name, row in table.items()}


def test_the_document_shows_the_values_in_force() -> None:
    """So no value changes without the document, which says where it comes from."""
    assert DOCUMENT.read_text(encoding="utf-8").endswith("\n\n" + paper_table())


def test_what_the_paper_states_in_numbers() -> None:
    """Sections IV-A, IV-B, IV-D and V-A."""
    config = preset("paper")
    assert config.model.gaussians_per_anchor == 10
    assert (config.keyframe.dropout_base, config.keyframe.dropout_slope) == (0.1, 0.05)
    assert (config.keyframe.growth_interval, config.keyframe.prune_opacity) == (200, 0.05)
    assert (config.predict.epochs, config.predict.posterior) == (10, 0.8)
    assert config.keyframe.dssim_weight == config.predict.dssim_weight == 0.2
    assert config.keyframe.average_from >= 1  # the last step, no mean
