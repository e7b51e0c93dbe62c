"""Settings of the method by name: every one of them can be reached, and what is wrong is said in one sentence."""

from __future__ import annotations

from dataclasses import fields

import pytest

from streamlod.core.errors import InputError
from streamlod.core.train import PredictConfig, preset
from streamlod.core.train.later_frame.parts import AnchorGrowth, FlowSearch
from streamlod.core.train.motion.cues import CUES
from streamlod.core.train.presets.settings import PARTS, Value, setting_names, with_settings


@pytest.mark.parametrize("name", ["live", "paper"])
def test_every_setting_is_reached_and_only_it_changes(name: str) -> None:
    config = preset(name)
    for setting in setting_names(config):
        if setting == "parts":
            continue
        group, own = setting.split(".")
        before = getattr(config, group, None) or next(part for part in config.parts if part.name == group)
        old = getattr(before, own)
        new: Value = not old if isinstance(old, bool) else (old or 0) + 1 if not isinstance(old, str) else old
        if setting in {"model.selection", "predict.cue"}:
            new = {"all": "distance", "distance": "all"}.get(old, "canonical")
        if setting == "predict.memory":
            new = old / 2
        changed = with_settings(config, {setting: new})
        after = getattr(changed, group, None) or next(part for part in changed.parts if part.name == group)
        assert getattr(after, own) == new, setting
        others = [field.name for field in fields(before) if field.name != own]
        assert [getattr(after, other) for other in others] == [getattr(before, other) for other in others]


def test_parts_are_left_out_and_keep_their_settings() -> None:
    config = with_settings(preset("live"), {"flow_search.pixels": 2})
    fewer = with_settings(config, {"new_anchors.share": 0.01, "parts": "new_anchors+flow_search"})
    assert fewer.parts == (AnchorGrowth(share=0.01), FlowSearch(pixels=2.0))
    assert with_settings(config, {"parts": ""}).parts == ()
    assert with_settings(config, {"parts": "gradient_growth"}).parts == (PARTS["gradient_growth"],)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"keyframe.step": 5}, r"'keyframe.step'.*did you mean keyframe.steps"),
        ({"steps": 5}, r"'steps': unknown; did you mean keyframe.steps\?"),
        ({"predict.steps": 5}, r"'predict.steps': unknown; did you mean keyframe.steps\?"),
        (
            {"gradient_growth.at": 0.2},
            r"gradient_growth does not take part; .* parts=flow_search\+new_anchors\+gradient",
        ),
        ({"nonsense": 5}, r"unknown; choose of flow_search.pixels, "),
        ({"keyframe.steps": 5.5}, "whole number from 0 to 10000000, not 5.5"),
        ({"keyframe.steps": True}, "whole number"),
        ({"keyframe.steps": -1}, "whole number"),
        ({"predict.epochs": 10**12}, "whole number"),
        ({"predict.rate_weight": "much"}, "a number from 0"),
        ({"predict.rate_weight": float("nan")}, "a number from 0"),
        ({"model.exposure": 1}, "true or false"),
        ({"model.selection": "some"}, "one of all, distance"),
        ({"model.levels": "few"}, "or none"),
        ({"predict.cue": "wild"}, "predict.cue: must be one of difference, canonical, everything, not 'wild'"),
        ({"model.gaussians_per_anchor": 0}, "a whole number from 1 to 16, not 0"),
        ({"model.features": 100_000}, "a whole number from 3 to 64"),
        ({"model.cell_pixels": 0}, "a number from 1 to"),
        ({"model.max_anchors": 0}, "a whole number from 16 to 1048576"),
        ({"keyframe.growth_interval": 0}, "a whole number from 1 to"),
        ({"predict.position_steps_per_cell": 0}, "a whole number from 1 to"),
        ({"predict.partition_interval": 0}, "a whole number from 1 to"),
        ({"keyframe.feature_rate": 1e6}, "a number from 0 to 10, not"),
        ({"predict.memory": 1}, "a number from 0 to 0.999, not 1"),
        ({"parts": "flow_serch"}, "did you mean flow_search"),
        ({"parts": "flow_search+flow_search"}, "twice"),
        ({"parts": "new_anchors", "flow_search.pixels": 2}, "unknown"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(changes: dict[str, Value], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        with_settings(preset("live"), changes)


def test_cues_that_can_be_given_are_those_that_there_are() -> None:
    told = {field.name: field.metadata for field in fields(PredictConfig)}
    assert set(told["cue"]["choices"]) == set(CUES)


def test_a_setting_that_may_be_missing_takes_none() -> None:
    config = with_settings(preset("live"), {"model.levels": 3})
    assert config.model.levels == 3
    assert with_settings(config, {"model.levels": "none"}).model.levels is None
