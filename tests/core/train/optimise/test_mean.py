"""The mean of parameters over training steps."""

from __future__ import annotations

import torch

from streamlod.core.train.optimise.adam import RowAdam


def test_mean_is_of_all_steps_that_were_counted() -> None:
    parameter = torch.tensor([0.0, 0.0], requires_grad=True)
    optimiser = RowAdam({"place": parameter})
    assert optimiser.mean == {}
    for step in ([1.0, 4.0], [2.0, 0.0], [6.0, -1.0]):
        with torch.no_grad():
            parameter.copy_(torch.tensor(step))
        optimiser.average()
    assert not optimiser.mean["place"].requires_grad
    torch.testing.assert_close(optimiser.mean["place"], torch.tensor([3.0, 1.0]))


def test_mean_begins_anew_where_parameters_join() -> None:
    place = torch.tensor([1.0], requires_grad=True)
    optimiser = RowAdam({"place": place})
    optimiser.average()
    with torch.no_grad():
        place.copy_(torch.tensor([3.0]))
    optimiser.join({"colour": torch.tensor([5.0], requires_grad=True)})
    optimiser.average()
    assert {name: value.item() for name, value in optimiser.mean.items()} == {"place": 3.0, "colour": 5.0}


def test_mean_begins_anew_where_rows_come_or_go() -> None:
    optimiser = RowAdam({"place": torch.tensor([[1.0], [2.0]], requires_grad=True)})
    optimiser.average()
    optimiser.replace_rows(torch.tensor([1]), {"place": torch.tensor([[7.0], [8.0]])})
    assert optimiser.mean == {}
    optimiser.average()
    assert optimiser.mean["place"].tolist() == [[2.0], [7.0], [8.0]]
