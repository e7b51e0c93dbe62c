"""Rules that say where a later frame adds anchors."""

from __future__ import annotations

import pytest

from streamlod.core.errors import InputError
from streamlod.core.train import PredictConfig
from streamlod.core.train.growth import later


def test_the_rule_takes_its_settings_from_the_configuration() -> None:
    assert later.later_growth(PredictConfig(growth_rule="gradient", growth_threshold=4.0)) == later.ByGradient(4.0)
    assert later.later_growth(PredictConfig(rate_weight=7.0)) == later.ByError(5.0)


def test_an_unknown_rule_is_refused_and_the_known_are_named() -> None:
    with pytest.raises(InputError, match="choose one of error, gradient"):
        later.later_growth(PredictConfig(growth_rule="random"))
