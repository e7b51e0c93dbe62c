"""The mean of parameters over training steps."""

from __future__ import annotations

import torch

from streamlod.core.train.optimise.mean import MeanOfSteps


def test_mean_is_of_all_steps_that_were_counted() -> None:
    mean = MeanOfSteps()
    parameter = torch.tensor([0.0, 0.0], requires_grad=True)
    for step in ([1.0, 4.0], [2.0, 0.0], [6.0, -1.0]):
        with torch.no_grad():
            parameter.copy_(torch.tensor(step))
        mean.count({"place": parameter})
    assert not mean.values["place"].requires_grad
    torch.testing.assert_close(mean.values["place"], torch.tensor([3.0, 1.0]))


def test_nothing_is_known_before_the_first_step() -> None:
    assert MeanOfSteps().values == {}


def test_mean_begins_anew_where_parameters_join() -> None:
    mean = MeanOfSteps()
    mean.count({"place": torch.tensor([1.0])})
    mean.count({"place": torch.tensor([3.0]), "colour": torch.tensor([5.0])})
    assert {name: value.item() for name, value in mean.values.items()} == {"place": 3.0, "colour": 5.0}
