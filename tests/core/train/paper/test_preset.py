"""The preset `paper`: every setting says what the paper takes and why, and the documented table is the one in force."""

from __future__ import annotations

from dataclasses import fields

import pytest

from streamlod.core.train import KeyframeConfig, ModelConfig, PredictConfig, preset
from streamlod.core.train.setting import Choice
from tests.paper_page import PAGE, page

PARTS = [ModelConfig, KeyframeConfig, PredictConfig]


@pytest.mark.parametrize("part", PARTS)
def test_every_setting_has_a_meaning_and_a_source(part: type) -> None:
    for field in fields(part):
        choice = field.metadata["paper"]
        assert isinstance(choice, Choice), field.name
        assert choice.why, field.name
        assert field.metadata["meaning"], field.name


def test_the_preset_holds_the_papers_values() -> None:
    config = preset("paper")
    for part in (config.model, config.keyframe, config.predict):
        expected = {field.name: field.metadata["paper"].value for field in fields(part)}
        assert {name: getattr(part, name) for name in expected} == expected


def test_the_document_shows_the_values_in_force() -> None:
    """So no value changes without the document, which says where it comes from."""
    assert PAGE.read_text(encoding="utf-8") == page()


def test_what_the_paper_states_in_numbers() -> None:
    """Sections IV-A, IV-B, IV-D and V-A."""
    config = preset("paper")
    assert config.model.gaussians_per_anchor == 10
    assert (config.keyframe.dropout_base, config.keyframe.dropout_slope) == (0.1, 0.05)
    assert (config.keyframe.growth_interval, config.keyframe.prune_opacity) == (200, 0.05)
    assert (config.predict.epochs, config.predict.posterior) == (10, 0.8)
    assert config.keyframe.dssim_weight == config.predict.dssim_weight == 0.2
    assert config.keyframe.average_from >= 1  # the last step, no mean
    assert config.predict.average_from >= 1
